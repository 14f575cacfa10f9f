"""What is kept of every evaluated scene: the prediction beside the truth, in one compressed file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from binpick_env.scenes.clutter import ClutterStats
from perception.geometry import Floats, require_shape
from perception.instance import Instance, instances_of
from perception.metrics.matching import SceneMatches, SceneTruth, match_scene
from perception.runtime.files import replace_atomically
from perception.segmentation.scoring import COUNTED_FROM, truth_of

RECORD_VERSION = 1  # raise it when a field changes its meaning: older records are then computed anew
STAGES = ("boundary", "surface", "segmentation", "total")


class RecordError(ValueError):
    """A file does not hold a whole record of this version."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneRecord:
    """One evaluated scene of N boundary points, P parts and G predicted instances.

    Attributes:
        labels: (N,) int64 predicted instance of each point, -1 for none.
        scores: (G,) confidence of the instances.
        instance_ids: (N,) int64 part that each point lies on, -1 for the container.
        visible_fractions: (P,) in [0, 1].
        pixels: (N, 2) int64 pixel (u, v) of each point.
        picture: (h, w) uint8 grey image around the bin; (0, 0) if none was kept.
        corner: Column and row of its first pixel in the camera's image.
        wrong_side: Points on the wrong side of a contour, see :func:`binpick_env.scenes.boundary_quality.wrong_side`.
        contour: Points at contours.
        ms: Wall clock of each of `STAGES` [ms].
        threads: That computed at the same time.
        git_commit: Of the code that made it, "" outside of a checkout.
    """

    labels: NDArray[np.int64]
    scores: Floats
    instance_ids: NDArray[np.int64]
    visible_fractions: Floats
    pixels: NDArray[np.int64]
    picture: NDArray[np.uint8]
    corner: tuple[int, int]
    wrong_side: int
    contour: int
    ms: dict[str, float]
    threads: int
    git_commit: str

    def __post_init__(self) -> None:
        count = len(self.instance_ids)
        require_shape("labels", self.labels, (count,))
        require_shape("pixels", self.pixels, (count, 2))
        if self.labels.max(initial=-1) >= len(self.scores):
            raise ValueError(f"labels go up to {self.labels.max()}, but there are {len(self.scores)} scores")
        if set(self.ms) != set(STAGES):
            raise ValueError(f"ms must have {', '.join(STAGES)}, got {', '.join(self.ms)}")

    def instances(self) -> list[Instance]:
        """Return the prediction, best first."""
        return instances_of(self.labels, self.scores)

    def truth(self, visible: tuple[float, float] = (COUNTED_FROM, np.inf)) -> SceneTruth:
        """Return the ground truth, of which parts with a visible fraction within [low, high) count."""
        return truth_of(self.instance_ids, self.visible_fractions, visible)

    def matches(self, visible: tuple[float, float] = (COUNTED_FROM, np.inf)) -> SceneMatches:
        """Return the verdicts on the prediction, over every boundary point in the bin."""
        return match_scene(self.truth(visible), self.instances())

    @property
    def clutter(self) -> ClutterStats:
        """How hidden the parts are."""
        return ClutterStats.from_fractions(self.visible_fractions)

    def save(self, path: Path) -> None:
        """Write a compressed file in one piece, or not at all."""
        arrays: dict[str, Any] = {
            "version": np.int64(RECORD_VERSION),
            "labels": self.labels.astype(np.int32),
            "scores": self.scores,
            "instance_ids": self.instance_ids.astype(np.int16),
            "visible_fractions": self.visible_fractions,
            "pixels": self.pixels.astype(np.int16),
            "picture": self.picture,
            "corner": np.array(self.corner, np.int64),
            "contour": np.array([self.wrong_side, self.contour], np.int64),
            "ms": np.array([self.ms[name] for name in STAGES]),
            "threads": np.int64(self.threads),
            "git_commit": np.str_(self.git_commit),
        }

        def write(draft: Path) -> None:
            with draft.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **arrays)

        replace_atomically(path, write)

    @classmethod
    def load(cls, path: Path) -> "SceneRecord":
        """Read a record.

        Raises:
            RecordError: The file is missing, cut off or of another version.
        """
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                a = {name: stored[name] for name in stored.files}
            if int(a["version"]) != RECORD_VERSION:
                raise RecordError(f"{path} is of version {a['version']}, this code reads {RECORD_VERSION}")
            return cls(
                labels=a["labels"].astype(np.int64),
                scores=a["scores"],
                instance_ids=a["instance_ids"].astype(np.int64),
                visible_fractions=a["visible_fractions"],
                pixels=a["pixels"].astype(np.int64),
                picture=a["picture"],
                corner=(int(a["corner"][0]), int(a["corner"][1])),
                wrong_side=int(a["contour"][0]),
                contour=int(a["contour"][1]),
                ms=dict(zip(STAGES, a["ms"].tolist(), strict=True)),
                threads=int(a["threads"]),
                git_commit=str(a["git_commit"]),
            )
        except RecordError:
            raise
        except Exception as error:  # from zipfile, zlib and NumPy's header parser a flipped bit draws nearly anything
            raise RecordError(f"{path} holds no whole record ({error})") from error


def record_path(folder: Path, index: int) -> Path:
    """Return where the record of scene ``index`` is kept."""
    return folder / f"scene_{index:05d}.npz"
