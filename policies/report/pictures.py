"""Pictures of a bin for the report: before the first decision, after the last, and one of every decision."""

from pathlib import Path

import cv2
import numpy as np

from binpick_env.cell.render import PicturePainter, look_at
from binpick_env.cell.simulation import Simulation
from binpick_env.env import BinPickEnv
from perception.geometry import Floats
from perception.runtime.files import write_bytes_atomically
from policies.evaluation.listeners import BinListener, Decision
from policies.report.pick_picture import draw_decision, part_edges

OVERVIEW = (640, 480)  # width and height [px]
QUALITY = {".jpg": (cv2.IMWRITE_JPEG_QUALITY, 82), ".webp": (cv2.IMWRITE_WEBP_QUALITY, 60)}


class Album(BinListener):
    """Writes a bin's pictures beside its record: views of the bin as .jpg, decisions as .webp."""

    def __init__(self, folder: Path, stem: str) -> None:
        """Write nothing yet.

        Args:
            folder: Folder of the pictures; it is made with the first one.
            stem: Beginning of the pictures' file names.
        """
        self._folder, self._stem = folder, stem

    def bin_settled(self, env: BinPickEnv) -> str:
        """Write a view of the settled bin and return the file's name."""
        return self._write_view(env, "before")

    def after_decision(self, env: BinPickEnv, decision: Decision) -> str:  # noqa: ARG002
        """Write the picture of a decision and return the file's name."""
        picture = draw_decision(decision, part_edges(decision.labelled_capture.part))
        return self._write(picture, f"pick_{decision.number:02d}.webp")

    def bin_ended(self, env: BinPickEnv) -> str:
        """Write a view of the bin at its end and return the file's name."""
        return self._write_view(env, "after")

    def _write_view(self, env: BinPickEnv, moment: str) -> str:
        picture = PicturePainter(env.simulation).paint(bin_viewpoint(env.simulation), *OVERVIEW)
        return self._write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), f"{moment}.jpg")

    def _write(self, picture: cv2.typing.MatLike, name: str) -> str:
        file = f"{self._stem}_{name}"
        suffix = Path(file).suffix
        coded, data = cv2.imencode(suffix, picture, QUALITY[suffix])
        if not coded:
            raise RuntimeError(f"OpenCV could not encode {file}")
        write_bytes_atomically(self._folder / file, data.tobytes())
        return file


def bin_viewpoint(simulation: Simulation) -> Floats:
    """Return ``T_world_cam`` (4, 4) of a camera that looks steeply down into the whole bin from the tray's side."""
    x, y = simulation.config.bin.position
    return look_at(np.array([x + 0.25, y - 0.12, 0.74]), np.array([x + 0.01, y, 0.05]))
