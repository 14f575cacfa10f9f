"""Whole inputs that the grammars damage: a frame, a part, a scene, weights, and the folder of a finished job."""

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from binpick_env.config import CameraConfig
from binpick_env.scenes.synthesis import SceneConfig, make_scene
from perception.capture import read_frame, write_frame
from perception.frame import Frame, Workspace
from perception.geometry import deproject_depth, make_transform, transform_points
from perception.segmentation.weights import SHIPPED
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job, run_job
from policies.frames.example_frame import copy_example
from policies.selection.network import SelectorNet
from policies.selection.weights import save_selector

SIZE = (160, 120)  # width and height of the frame's images, small so that a case is quick [px]
CAMERA = CameraConfig(width=640, height=480)  # of the job


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Whole inputs in one folder.

    Attributes:
        folder: Their folder.
    """

    folder: Path

    @classmethod
    def in_folder(cls, folder: Path) -> "Samples":
        """Return the samples of a folder; they are made if it does not exist yet."""
        if not folder.exists():
            folder.parent.mkdir(parents=True, exist_ok=True)
            draft = Path(tempfile.mkdtemp(prefix=".samples", dir=folder.parent))
            try:
                _make(draft)
                draft.replace(folder)
            except BaseException:
                shutil.rmtree(draft, ignore_errors=True)
                raise
        return cls(folder=folder)

    def frame(self) -> Frame:
        """Return the small frame."""
        return read_frame(self.folder / "small.npz")

    @property
    def workspace(self) -> Workspace:
        """Bin that the frame shows, in the camera's frame as the world."""
        T_world_bin = make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.9))
        return Workspace(T_world_bin=T_world_bin, inner_size=np.array([0.3, 0.2, 0.12]))


def _make(folder: Path) -> None:
    copy_example(folder / "example")
    frame = _small_frame()
    write_frame(frame, folder / "small.npz")
    write_frame(frame, folder / "small.json", scale=0.0001)
    _write_clouds(frame, folder)
    for path in SHIPPED.glob("general-dgcnn-context.*"):
        shutil.copyfile(path, folder / f"weights{path.suffix}")
    save_selector(folder / "selector.safetensors", SelectorNet(), {"part": "tee"})
    make_scene(SceneConfig(part="tee", num_parts=(2, 2), camera=CAMERA), 0).scene.save(folder / "scene.npz")
    config = EvaluationConfig(part="tee", perception="oracle", num_parts=(2, 2), camera=CAMERA)
    run_job(config, Job(out=folder / "pick", bins=2))


def _small_frame() -> Frame:
    """Return the frame of two blocks on a floor, 0.9 m below the camera."""
    width, height = SIZE
    K = np.array([[300.0, 0, (width - 1) / 2], [0, 300.0, (height - 1) / 2], [0, 0, 1]])
    grey, depth = np.full((height, width), 120, np.uint8), np.full((height, width), 0.9, np.float32)
    for (v0, u0, v1, u1), z in (((30, 40, 60, 80), 0.86), ((70, 90, 100, 110), 0.88)):
        depth[v0:v1, u0:u1], grey[v0:v1, u0:u1] = z, 60
    return Frame(grey=grey, depth=depth, K=K, T_world_cam=np.eye(4))


def _write_clouds(frame: Frame, folder: Path) -> None:
    points = transform_points(np.eye(4), deproject_depth(frame.K, frame.depth)).reshape(-1, 3)[::16].astype(np.float32)
    lines = "".join(f"{x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in points.tolist())
    count, raw = len(points), points.astype("<f4").tobytes()
    pcd = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA "
    )
    ply = f"\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    (folder / "ascii.pcd").write_text(f"{pcd}ascii\n{lines}", encoding="utf-8")
    (folder / "binary.pcd").write_bytes(f"{pcd}binary\n".encode() + raw)
    (folder / "ascii.ply").write_text(f"ply\nformat ascii 1.0{ply}{lines}", encoding="utf-8")
    (folder / "binary.ply").write_bytes(f"ply\nformat binary_little_endian 1.0{ply}".encode() + raw)
    (folder / "cloud.xyz").write_text(lines, encoding="utf-8")
