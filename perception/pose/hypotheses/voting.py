"""Hough voting: pose hypotheses from boundary points and a part's pair table.

Each reference point of the scene is assumed to lie on the part. Its pairs vote for the model point that it is, for
whether the two tangents point the same way, and for the rotation of the part about the tangent.
"""

import math
from dataclasses import dataclass

import numpy as np

from perception.geometry import Floats, require_shape
from perception.pose.hypotheses._kernels import vote_references
from perception.pose.model._pair_kernels import Ints, tangent_frames
from perception.pose.model.pair_features import WEIGHT_ONE, PairTable, unit, usable


@dataclass(frozen=True, kw_only=True)
class VoteConfig:
    """Settings of the accumulator and of its peaks.

    Attributes:
        bins: Number of bins of the rotation about the tangent.
        reference_step: Step through the boundary points from one reference point to the next.
        min_references: Number of references below which the step is made smaller.
        second_peak: Share of the best peak's votes with which the second best pose of a reference is kept.
        second_distance: Distance of the part's centres above which two poses differ, as a share of ``d_max``.
        second_angle: Angle above which two poses differ [rad].
        keep: Largest number of poses to return; the default is as many as later steps can try.
    """

    bins: int = 30
    reference_step: int = 8
    min_references: int = 25
    second_peak: float = 0.9
    second_distance: float = 0.1
    second_angle: float = math.radians(15)
    keep: int = 100

    def __post_init__(self) -> None:
        if not 3 <= self.bins <= 256:
            raise ValueError(f"bins must be in [3, 256], got {self.bins}")
        for name in ("reference_step", "min_references", "keep"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 0 < self.second_peak <= 1:
            raise ValueError(f"second_peak must be in (0, 1], got {self.second_peak}")
        for name in ("second_distance", "second_angle"):
            if not 0 < getattr(self, name) <= math.pi:
                raise ValueError(f"{name} must be in (0, pi], got {getattr(self, name)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class RawPoses:
    """Poses with their votes, most votes first; of equal ones the lower reference comes first.

    Attributes:
        T_cam_part: (K, 4, 4) poses of the part in the camera frame.
        votes: (K,) float64 weighted number of pairs that agree, smoothed over neighbouring rotations.
        reference: (K,) int64 index of the scene point that each pose was found at.
    """

    T_cam_part: Floats
    votes: Floats
    reference: Ints

    def __post_init__(self) -> None:
        require_shape("T_cam_part", self.T_cam_part, (None, 4, 4))
        require_shape("votes", self.votes, (len(self.T_cam_part),))
        require_shape("reference", self.reference, (len(self.T_cam_part),))

    def __len__(self) -> int:
        return len(self.votes)


def reference_points(count: int, config: VoteConfig | None = None) -> Ints:
    """Return the (Q,) indices of the reference points among ``count`` points."""
    config = config or VoteConfig()
    return np.arange(0, count, min(max(count // config.min_references, 1), config.reference_step))


def vote(
    table: PairTable,
    points_cam: Floats,
    tangents_cam: Floats,
    references: Ints | None = None,
    config: VoteConfig | None = None,
) -> RawPoses:
    """Return the poses that the pairs of boundary points vote for.

    Args:
        table: Pair table of the part.
        points_cam: (N, 3) boundary points thinned like the model, camera frame [m].
        tangents_cam: (N, 3) tangents of any sign and length; points whose tangent is zero are left out.
        references: (Q,) indices of the points to find poses at; those of :func:`reference_points` if None.
        config: Settings; the defaults of :class:`VoteConfig` if None.

    Returns:
        Up to ``config.keep`` poses; none if no two points form a pair.

    Raises:
        ValueError: Shapes differ, or ``references`` are no indices of points.

    Note:
        Deterministic. Takes 1 to 4 ms for a part of 150 points and 25 references, 5 to 9 ms for 400 points and 50.
    """
    config = config or VoteConfig()
    require_shape("points_cam", points_cam, (None, 3))
    require_shape("tangents_cam", tangents_cam, (len(points_cam), 3))
    kept = usable(points_cam, tangents_cam)
    if references is None:
        chosen = reference_points(len(kept), config)
    else:
        chosen = _positions(references, kept, len(points_cam))
    units = unit(tangents_cam[kept])
    T, score = vote_references(
        np.ascontiguousarray(points_cam[kept], dtype=np.float64),
        units,
        tangent_frames(units),
        chosen,
        table.offsets,
        table.entries,
        table.weights,
        table.grid,
        config.bins,
        table.points,
        table.frames,
        table.centre,
        config.second_peak,
        config.second_distance * table.d_max,
        math.cos(config.second_angle),
    )
    found = np.flatnonzero(score.ravel() > 0)
    reference = np.repeat(kept[chosen], 2)
    # The sort is stable, so that the best pose of a reference comes before its second one.
    order = found[np.lexsort((reference[found], -score.ravel()[found]))][: config.keep]
    return RawPoses(
        T_cam_part=T.reshape(-1, 4, 4)[order],
        votes=score.ravel()[order] / (4.0 * WEIGHT_ONE),
        reference=reference[order],
    )


def _positions(references: Ints, kept: Ints, count: int) -> Ints:
    """Return the positions of the references among the ``kept`` of ``count`` points, without those left out."""
    require_shape("references", references, (None,))
    if not np.issubdtype(references.dtype, np.integer):
        raise ValueError(f"references must be integers, got {references.dtype}")
    if len(references) and (references.min() < 0 or references.max() >= count):
        raise ValueError(f"references must be in [0, {count}), got {references.min()} to {references.max()}")
    place = np.full(count, -1, dtype=np.int64)
    place[kept] = np.arange(len(kept))
    return place[references][place[references] >= 0]
