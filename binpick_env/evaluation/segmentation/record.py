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
from perception.runtime.records import RecordFormat
from perception.segmentation.scoring import COUNTED_FROM, truth_of

FORMAT = RecordFormat(kind="segmentation record", version=1, remedy="evaluate_segmentation makes it again")
STAGES = ("boundary", "surface", "segmentation", "total")


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneRecord:
    """One evaluated scene of N boundary points, P parts and G predicted instances.

    Attributes:
        labels: (N,) int64 predicted instance of each point, -1 for none.
        scores: (G,) confidence of each instance, in [0, 1].
        instance_ids: (N,) int64 true part of each point, -1 for the container.
        visible_fractions: (P,) true visible fraction of each part, in [0, 1].
        pixels: (N, 2) int64 pixel (u, v) of each point.
        picture: (h, w) uint8 grey image around the bin; (0, 0) if it was not kept.
        corner: Column and row of the picture's first pixel in the camera's image.
        wrong_side: Number of points on the wrong side of a contour, see
            :func:`binpick_env.scenes.boundary_quality.wrong_side`.
        contour: Number of points at contours.
        ms: Wall clock of each of `STAGES` [ms].
        threads: Number of threads that computed the scene.
        git_commit: Commit of the code that made the record; empty outside a Git checkout.
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
        """Return the predicted instances by descending score."""
        return instances_of(self.labels, self.scores)

    def truth(self, visible: tuple[float, float] = (COUNTED_FROM, np.inf)) -> SceneTruth:
        """Return the ground truth, in which parts with a visible fraction in [low, high) count."""
        return truth_of(self.instance_ids, self.visible_fractions, visible)

    def matches(self, visible: tuple[float, float] = (COUNTED_FROM, np.inf)) -> SceneMatches:
        """Match the predicted instances to the parts with a visible fraction in [low, high), over all points."""
        return match_scene(self.truth(visible), self.instances())

    @property
    def clutter(self) -> ClutterStats:
        """Statistics of the visible fractions."""
        return ClutterStats.from_fractions(self.visible_fractions)

    def save(self, path: Path) -> None:
        """Write the record as a compressed file, atomically."""
        arrays: dict[str, Any] = {
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
        FORMAT.save_arrays(path, arrays)

    @classmethod
    def load(cls, path: Path) -> "SceneRecord":
        """Read a record.

        Raises:
            RecordError: The file is missing, cut off or of another version.
        """
        return FORMAT.load_arrays(path, cls._from_arrays)

    @classmethod
    def _from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> "SceneRecord":
        return cls(
            labels=arrays["labels"].astype(np.int64),
            scores=arrays["scores"],
            instance_ids=arrays["instance_ids"].astype(np.int64),
            visible_fractions=arrays["visible_fractions"],
            pixels=arrays["pixels"].astype(np.int64),
            picture=arrays["picture"],
            corner=(int(arrays["corner"][0]), int(arrays["corner"][1])),
            wrong_side=int(arrays["contour"][0]),
            contour=int(arrays["contour"][1]),
            ms=dict(zip(STAGES, arrays["ms"].tolist(), strict=True)),
            threads=int(arrays["threads"]),
            git_commit=str(arrays["git_commit"]),
        )


def record_path(folder: Path, index: int) -> Path:
    """Return the path of the record of scene ``index``."""
    return folder / f"scene_{index:05d}.npz"
