"""Pictures that people look at: the bin before and after, and every decision."""

import time
from pathlib import Path

import cv2
import numpy as np

from binpick_env.cell.render import PicturePainter, look_at
from binpick_env.cell.simulation import Simulation
from binpick_env.env import BinPickEnv
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.perceiver import LabelledCapture
from perception.geometry import Floats
from policies.evaluation.frame_record import FrameRecord
from policies.grasping.outcomes import GraspCandidate
from policies.report.pick_picture import part_edges, pick_picture

OVERVIEW = (640, 480)  # width and height [px]
QUALITY = {".jpg": (cv2.IMWRITE_JPEG_QUALITY, 82), ".webp": (cv2.IMWRITE_WEBP_QUALITY, 80)}


class Album:
    """Keeps a bin's pictures beside its record: views as .jpg, decisions as .webp; without a folder nothing."""

    def __init__(self, folder: Path | None, stem: str) -> None:
        self._folder, self._stem = folder, stem
        self.seconds = 0.0  # wall clock spent here

    def overview(self, env: BinPickEnv, moment: str) -> str:
        """Keep a view into the bin and return the file's name, "" if there is no folder."""
        if self._folder is None:
            return ""
        start = time.perf_counter()
        picture = PicturePainter(env.simulation).paint(bin_viewpoint(env.simulation), *OVERVIEW)
        return self._keep(self._folder, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), f"{moment}.jpg", start)

    def decision(
        self,
        labelled_capture: LabelledCapture,
        observed: ObservedCandidates,
        judged: FrameRecord,
        grasp: GraspCandidate | None,
        number: int,
    ) -> str:
        """Keep the picture of a bin's decision ``number`` and return the file's name, "" if there is no folder."""
        if self._folder is None:
            return ""
        start = time.perf_counter()
        picture = pick_picture(labelled_capture, observed, judged, grasp, part_edges(labelled_capture.part))
        return self._keep(self._folder, picture, f"pick_{number:02d}.webp", start)

    def _keep(self, folder: Path, picture: cv2.typing.MatLike, name: str, start: float) -> str:
        folder.mkdir(parents=True, exist_ok=True)
        file = f"{self._stem}_{name}"
        suffix = Path(file).suffix
        coded, data = cv2.imencode(suffix, picture, QUALITY[suffix])
        if not coded:
            raise RuntimeError(f"OpenCV could not encode {file}")
        (folder / file).write_bytes(data.tobytes())
        self.seconds += time.perf_counter() - start
        return file


def bin_viewpoint(simulation: Simulation) -> Floats:
    """Return ``T_world_cam`` (4, 4) of a camera that looks steeply down into the whole bin from the tray's side."""
    x, y = simulation.config.bin.position
    return look_at(np.array([x + 0.25, y - 0.12, 0.74]), np.array([x + 0.01, y, 0.05]))
