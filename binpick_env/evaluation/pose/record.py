"""Record of a scene whose poses were estimated: groups, poses and ground truth, in one file."""

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
VERDICT_COLUMNS = (*VERDICT, "margin", "score_drop", "size")
DOUBT_COLUMNS = ("patch", "stray", "noise", "rotation_error")
TRIALS = 3  # recognition trials in each scene, as in the paper
_INTS = {"labels": np.int32, "explained": np.int32, "instance_ids": np.int16, "pixels": np.int16}  # stored types
_PLAIN = ("confidences", "explained_confidences", "visible_fractions", "T_cam_parts", "trials", "poses", "scores")
_ARRAYS = (*_INTS, *_PLAIN, "groups", "estimated_fractions", "verdicts", "doubts", "verified", "picture", "K")
_STORED_NAMES = {"estimated_fractions": "seen"}  # array names in the file that differ from the field's name


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseRecord:
    """One evaluated scene of N boundary points, P parts, G groups of points and E estimated poses.

    Attributes:
        labels: (N,) int64 group of each point, -1 for none. Where the whole scene was searched at once, the groups are
            the true segments, which only define the trials.
        confidences: (G,) confidence of each group by the segmentation, in [0, 1].
        explained: (N,) int64 group of each point after explanation by the poses, -1 for none.
        explained_confidences: (X,) confidence of each group after explanation, in [0, 1].
        instance_ids: (N,) int64 true part of each point, -1 for the container.
        visible_fractions: (P,) true visible fraction of each part, in [0, 1].
        T_cam_parts: (P, 4, 4) true poses in the camera frame.
        trials: (T,) int64 groups that are recognition trials; T is at most `TRIALS`.
        poses: (E, 4, 4) estimated ``T_cam_part``, verified or not; at most one for each group, and for what is left
            over of it.
        scores: (E,) score of each pose, in [0, 1].
        groups: (E,) int64 group that each pose was found in; -1 for the whole scene, and for what poses left over.
        estimated_fractions: (E,) visible fraction that the estimator assigns to each pose.
        verdicts: (E, 8) verification results of each pose, in the order of `VERDICT_COLUMNS`.
        doubts: (E, 4) what lowers the score of each pose beside its verdict, in the order of `DOUBT_COLUMNS`; NaN in
            records of older versions.
        verified: (E,) bool, whether the estimator returns the pose.
        pixels: (N, 2) int64 pixel (u, v) of each point.
        picture: (h, w) uint8 grey image around the bin; (0, 0) if it was not kept.
        corner: Column and row of the picture's first pixel in the camera's image.
        K: (3, 3) camera matrix [px].
        whole_scene: Whether poses were searched in the whole scene at once.
        ms: Wall clock of each of `STAGES` [ms]. "pose" is that of all groups, "trials" that of the trials' groups alone
            (NaN without any). "total" excludes "trials" and "explanation".
        threads: Number of threads that computed the scene.
        git_commit: Commit of the code that made the record; empty outside a Git checkout.
        causes: Names of the likely causes of lost parts in the frame's report; none in records of older versions.
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
    estimated_fractions: Floats
    verdicts: Floats
    doubts: Floats
    verified: NDArray[np.bool_]
    pixels: NDArray[np.int64]
    picture: NDArray[np.uint8]
    corner: tuple[int, int]
    K: Floats
    whole_scene: bool
    ms: dict[str, float]
    threads: int
    git_commit: str
    causes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count, estimates = len(self.instance_ids), len(self.poses)
        require_shape("doubts", self.doubts, (estimates, len(DOUBT_COLUMNS)))
        for name in ("labels", "explained"):
            require_shape(name, getattr(self, name), (count,))
        require_shape("pixels", self.pixels, (count, 2))
        require_shape("T_cam_parts", self.T_cam_parts, (len(self.visible_fractions), 4, 4))
        require_shape("poses", self.poses, (estimates, 4, 4))
        require_shape("verdicts", self.verdicts, (estimates, len(VERDICT_COLUMNS)))
        for name in ("scores", "groups", "estimated_fractions", "verified"):
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
        """Return the (G,) part that most of each group's points lie on, and the (G,) share of its points on that part.

        Ties go to the part of the lowest index. A group without points on parts has part -1 and share 0.
        """
        groups, parts = len(self.confidences), len(self.visible_fractions)
        inside = (self.labels >= 0) & (self.instance_ids >= 0)
        shared = np.zeros((groups, parts + 1), np.int64)  # at least one column, also without parts
        np.add.at(shared, (self.labels[inside], self.instance_ids[inside]), 1)
        most = shared.max(axis=1, initial=0)
        owners = np.where(most > 0, shared.argmax(axis=1), -1)
        return owners, most / np.maximum(self.sizes(), 1)

    def segmentation(self, explained: bool = False) -> SceneRecord:
        """Return the groups as a record of a segmentation, without counts of points at contours.

        Args:
            explained: Whether to return the groups after explanation by the poses.
        """
        ms = {name: self.ms[name] for name in SEGMENTATION_STAGES if name != "total"}
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
            ms={**ms, "total": sum(ms.values())},
            threads=self.threads,
            git_commit=self.git_commit,
        )

    def save(self, path: Path) -> None:
        """Write the record as a compressed file, atomically."""
        arrays: dict[str, Any] = {_STORED_NAMES.get(name, name): getattr(self, name) for name in _ARRAYS}
        arrays |= {name: arrays[name].astype(kind) for name, kind in _INTS.items()}
        arrays |= {
            "corner": np.array(self.corner, np.int64),
            "ms": np.array([self.ms[name] for name in STAGES]),
            "whole_scene": np.bool_(self.whole_scene),
            "threads": np.int64(self.threads),
            "git_commit": np.str_(self.git_commit),
            "causes": np.array(self.causes, np.str_),
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
        doubts = arrays.get("doubts", np.zeros((len(arrays["poses"]), 0)))
        older = np.full((len(doubts), len(DOUBT_COLUMNS) - doubts.shape[1]), np.nan)  # columns it does not have yet
        arrays = arrays | {"doubts": np.column_stack([doubts, older])}
        fields: dict[str, Any] = {name: arrays[_STORED_NAMES.get(name, name)] for name in _ARRAYS}
        return cls(
            **(fields | {name: fields[name].astype(np.int64) for name in _INTS}),
            corner=(int(arrays["corner"][0]), int(arrays["corner"][1])),
            ms=dict(zip(STAGES, arrays["ms"].tolist(), strict=True)),
            whole_scene=bool(arrays["whole_scene"]),
            threads=int(arrays["threads"]),
            git_commit=str(arrays["git_commit"]),
            causes=tuple(str(name) for name in arrays["causes"]) if "causes" in arrays else (),
        )
