"""Pictures that people look at: the bin before and after, the grasp that failed, the whole cell."""

import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.env import BinPickEnv
from binpick_env.render import PicturePainter, look_at
from binpick_env.simulation import Simulation
from perception.frame import Frame
from perception.geometry import Floats, invert_transform, project_points, transform_points
from policies.outcomes import GraspCandidate, PickResult

OVERVIEW = (640, 480)  # width and height [px]
CROP = 0.17  # edge of the square around a failed grasp [m]
CROP_PX = 320
JPEG_QUALITY = 82
_JAW, _APPROACH = (40, 140, 255), (90, 220, 90)  # orange and green, BGR
_PAD = 0.011  # half the width of a pad [m]


class Album:
    """Keeps a bin's pictures as .jpg beside its record; without a folder it keeps nothing."""

    def __init__(self, folder: Path | None, stem: str) -> None:
        self._folder, self._stem = folder, stem
        self.seconds = 0.0  # wall clock spent here

    def overview(self, env: BinPickEnv, moment: str) -> str:
        """Keep a view into the bin and return the file's name, "" if there is no folder."""
        if self._folder is None:
            return ""
        start = time.perf_counter()
        picture = PicturePainter(env.simulation).paint(bin_viewpoint(env.simulation), *OVERVIEW)
        return self._keep(self._folder, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), moment, start)

    def failure(self, frame: Frame, result: PickResult, number: int) -> str:
        """Keep the frame around the grasp of ``result`` with the jaw drawn; "" if there is no folder or no grasp."""
        if self._folder is None or result.grasp is None:
            return ""
        start = time.perf_counter()
        return self._keep(self._folder, grasp_picture(frame, result.grasp), f"pick_{number:02d}", start)

    def _keep(self, folder: Path, picture: cv2.typing.MatLike, name: str, start: float) -> str:
        folder.mkdir(parents=True, exist_ok=True)
        file = f"{self._stem}_{name}.jpg"
        coded, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if not coded:
            raise RuntimeError(f"OpenCV could not encode {file}")
        (folder / file).write_bytes(data.tobytes())
        self.seconds += time.perf_counter() - start
        return file


def bin_viewpoint(simulation: Simulation) -> Floats:
    """Return ``T_world_cam`` (4, 4) of a camera that looks steeply down into the whole bin from the tray's side."""
    x, y = simulation.config.bin.position
    return look_at(np.array([x + 0.25, y - 0.12, 0.74]), np.array([x + 0.01, y, 0.05]))


def grasp_picture(frame: Frame, grasp: GraspCandidate) -> NDArray[np.uint8]:
    """Return a square BGR crop of the frame with the jaw as it opens (thin) and as it closes (thick).

    Args:
        frame: That the grasp was chosen on.
        grasp: With its contact pose in the world frame.
    """
    origin = grasp.T_world_grasp[:3, 3]
    T_cam_world = invert_transform(frame.T_world_cam)
    centre_cam = transform_points(T_cam_world, origin[None])[0]
    scale = CROP_PX * centre_cam[2] / (frame.K[0, 0] * CROP)  # crop pixels a frame pixel
    u, v = project_points(frame.K, centre_cam[None])[0]
    to_crop = np.array([[scale, 0.0, CROP_PX / 2 - scale * u], [0.0, scale, CROP_PX / 2 - scale * v]])
    grey = cv2.warpAffine(frame.grey, to_crop, (CROP_PX, CROP_PX), flags=cv2.INTER_LINEAR, borderValue=24)
    picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)

    def draw(points_grasp: list[tuple[float, float, float]], colour: tuple[int, int, int], thickness: int) -> None:
        points_world = transform_points(grasp.T_world_grasp, np.array(points_grasp))
        pixels = project_points(frame.K, transform_points(T_cam_world, points_world)) * scale + to_crop[:, 2]
        cv2.polylines(picture, [np.round(pixels * 8).astype(np.int32)], False, colour, thickness, cv2.LINE_AA, 3)

    draw([(0.0, 0.0, -0.05), (0.0, 0.0, 0.0)], _APPROACH, 2)
    for gap, thickness in ((grasp.opening, 1), (grasp.width, 3)):
        half = gap / 2
        draw([(0.0, -half, 0.0), (0.0, half, 0.0)], _JAW, 1)
        for side in (-half, half):
            draw([(-_PAD, side, 0.0), (_PAD, side, 0.0)], _JAW, thickness)
    return np.asarray(picture, dtype=np.uint8)
