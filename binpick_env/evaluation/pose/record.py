"""What is kept of every scene whose poses were estimated: segments and poses beside the truth, in one file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.segmentation.record import STAGES as SEGMENTATION_STAGES
from binpick_env.evaluation.segmentation.record import SceneRecord
from perception.geometry import Floats, require_shape
from perception.runtime.records import RecordFormat

FORMAT = RecordFormat(kind="pose record", version=2, remedy="evaluate_pose makes it again")
STAGES = ("boundary", "surface", "segmentation", "pose", "trials", "explanation", "total")
VERDICT = ("edge_score", "explained", "support", "violation", "measured")
EVIDENCE = (*VERDICT, "margin", "score_drop", "size")  # of each pose
TRIALS = 3  # groups of a scene whose poses the paper counts
_INTS = {"labels": np.int32, "explained": np.int32, "instance_ids": np.int16, "pixels": np.int16}  # as they are stored
_PLAIN = ("confidences", "explained_confidences", "visible_fractions", "T_cam_parts", "trials", "poses", "scores")
_KEPT = (*_INTS, *_PLAIN, "groups", "seen", "verdicts", "verified", "picture", "K")


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseRecord:
    """One evaluated scene of N boundary points, P parts, G groups of points and E estimated poses.

    Attributes:
        labels: (N,) int64 group of each point, -1 for none. Where the whole scene was searched at once, the groups are
            the true segments, and only say which parts the trials are about.
        confidences: (G,) the segmentation's, of the groups.
        explained: (N,) int64 group of each point after the poses have explained them, -1 for none.
        explained_confidences: (X,) of these groups.
        instance_ids: (N,) int64 part that each point lies on, -1 for the container.
        visible_fractions: (P,) in [0, 1].
        T_cam_parts: (P, 4, 4) true poses.
        trials: (at most `TRIALS`,) int64 groups that a recognition rate counts.
        poses: (E, 4, 4) estimated ``T_cam_part``: at most one a group, whether it was verified or not.
        scores: (E,) in [0, 1].
        groups: (E,) int64 group that each pose was found in, -1 if in the whole scene.
        seen: (E,) estimated share of the part that is visible.
        verdicts: (E, 8) the numbers of `EVIDENCE`.
        verified: (E,) bool what the estimator delivers.
        pixels: (N, 2) int64 pixel (u, v) of each point.
        picture: (h, w) uint8 grey image around the bin; (0, 0) if none was kept.
        corner: Column and row of its first pixel in the camera's image.
        K: (3, 3) of the camera [px].
        whole_scene: Whether poses were searched in the whole scene at once.
        ms: Wall clock of each of `STAGES` [ms]: "pose" of all groups, "trials" of the trials' groups alone, NaN where
            there is none; "total" is without the latter, and without "explanation".
        threads: That computed at the same time.
        git_commit: Of the code that made it, "" outside of a checkout.
    """

    labels: NDArray[np.int64]
    confidences: Floats
    explained: NDArray[np.int64]
    explained_confidences: Floats
    instance_ids: NDArray[np.int64]
    visible_fractions: Floats
    T_cam_parts: Floats
    trials: NDArray[np.int64]
    poses: Floats
    scores: Floats
    groups: NDArray[np.int64]
    seen: Floats
    verdicts: Floats
    verified: NDArray[np.bool_]
    pixels: NDArray[np.int64]
    picture: NDArray[np.uint8]
    corner: tuple[int, int]
    K: Floats
    whole_scene: bool
    ms: dict[str, float]
    threads: int
    git_commit: str

    def __post_init__(self) -> None:
        count, estimates = len(self.instance_ids), len(self.poses)
        for name in ("labels", "explained"):
            require_shape(name, getattr(self, name), (count,))
        require_shape("pixels", self.pixels, (count, 2))
        require_shape("T_cam_parts", self.T_cam_parts, (len(self.visible_fractions), 4, 4))
        require_shape("poses", self.poses, (estimates, 4, 4))
        require_shape("verdicts", self.verdicts, (estimates, len(EVIDENCE)))
        for name in ("scores", "groups", "seen", "verified"):
            require_shape(name, getattr(self, name), (estimates,))
        for name in ("labels", "trials", "groups", "explained"):
            highest = getattr(self, name).max(initial=-1)
            known = len(self.explained_confidences if name == "explained" else self.confidences)
            if highest >= known:
                raise ValueError(f"{name} go up to {highest}, but there are {known} groups")
        if set(self.ms) != set(STAGES):
            raise ValueError(f"ms must have {', '.join(STAGES)}, got {', '.join(self.ms)}")

    def sizes(self) -> NDArray[np.int64]:
        """Return the (G,) number of points of each group."""
        return np.bincount(self.labels + 1, minlength=len(self.confidences) + 1)[1:]

    def owners(self) -> tuple[NDArray[np.int64], Floats]:
        """Return the (G,) part that owns most of each group's points, and that share of its points.

        Of equal parts the first; -1 and 0 for a group without a point on any part.
        """
        groups, parts = len(self.confidences), len(self.visible_fractions)
        inside = (self.labels >= 0) & (self.instance_ids >= 0)
        shared = np.zeros((groups, parts + 1), np.int64)  # one column more, so that there is one without any part
        np.add.at(shared, (self.labels[inside], self.instance_ids[inside]), 1)
        most = shared.max(axis=1, initial=0)
        owners = np.where(most > 0, shared.argmax(axis=1), -1)
        return owners, most / np.maximum(self.sizes(), 1)

    def segmentation(self, explained: bool = False) -> SceneRecord:
        """Return the groups alone, for what judges and draws segmentations; its points at contours are not counted.

        Args:
            explained: Those after the poses have explained them.
        """
        spent = {name: self.ms[name] for name in SEGMENTATION_STAGES if name != "total"}
        return SceneRecord(
            labels=self.explained if explained else self.labels,
            scores=self.explained_confidences if explained else self.confidences,
            instance_ids=self.instance_ids,
            visible_fractions=self.visible_fractions,
            pixels=self.pixels,
            picture=self.picture,
            corner=self.corner,
            wrong_side=0,
            contour=0,
            ms={**spent, "total": sum(spent.values())},
            threads=self.threads,
            git_commit=self.git_commit,
        )

    def save(self, path: Path) -> None:
        """Write a compressed file in one piece, or not at all."""
        arrays: dict[str, Any] = {name: getattr(self, name) for name in _KEPT}
        arrays |= {name: arrays[name].astype(kind) for name, kind in _INTS.items()}
        arrays |= {
            "corner": np.array(self.corner, np.int64),
            "ms": np.array([self.ms[name] for name in STAGES]),
            "whole_scene": np.bool_(self.whole_scene),
            "threads": np.int64(self.threads),
            "git_commit": np.str_(self.git_commit),
        }
        FORMAT.save_arrays(path, arrays)

    @classmethod
    def load(cls, path: Path) -> "PoseRecord":
        """Read a record.

        Raises:
            RecordError: The file is missing, cut off or of another version.
        """
        return FORMAT.load_arrays(path, cls._from_arrays)

    @classmethod
    def _from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> "PoseRecord":
        kept: dict[str, Any] = {name: arrays[name] for name in _KEPT}
        return cls(
            **(kept | {name: kept[name].astype(np.int64) for name in _INTS}),
            corner=(int(arrays["corner"][0]), int(arrays["corner"][1])),
            ms=dict(zip(STAGES, arrays["ms"].tolist(), strict=True)),
            whole_scene=bool(arrays["whole_scene"]),
            threads=int(arrays["threads"]),
            git_commit=str(arrays["git_commit"]),
        )
