"""Pose candidates, and the padded arrays in which the environment observes them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.frame import Workspace
from perception.geometry import Floats, invert_transform, rotation_6d

MAX_CANDIDATES = 32  # K, the number of rows of an observation; standard bins hold at most 30 parts
FEATURES = (
    "x",
    "y",
    "z",  # centre in the bin frame [m]
    *(f"rotation_{i}" for i in range(6)),  # first two columns of R_bin_part
    "score",  # the perceiver's confidence in [0, 1]
    "visible_fraction",  # estimated share of the part's silhouette that is seen
    "height",  # height of the highest surface point above the bin's floor [m]
    "wall_distance",  # distance of the centre to the nearest wall [m]
    "fill",  # visible boundary points over P; the visible fraction where no boundary is extracted
)


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseCandidate:
    """One recognised part.

    Attributes:
        T_world_part: (4, 4) estimated pose of the part frame.
        centre_world: (3,) estimated position of the part's centre [m].
        score: Confidence in [0, 1].
        visible_fraction: Estimated share of the part's silhouette that is seen.
        top: Height of the highest surface point above the bin's floor [m].
        fill: Number of visible boundary points over P.
        part: True index of the part, for evaluation and reports only; -1 where unknown.
    """

    T_world_part: Floats
    centre_world: Floats
    score: float
    visible_fraction: float
    top: float
    fill: float
    part: int = -1


def candidate_row(candidate: PoseCandidate, workspace: Workspace) -> NDArray[np.float32]:
    """Encode one candidate as (F,) float32 in the order of :data:`FEATURES`."""
    T_bin_part = invert_transform(workspace.T_world_bin) @ candidate.T_world_part
    centre = workspace.to_bin(candidate.centre_world[None])[0]
    wall = float(np.min(workspace.inner_size[:2] / 2 - np.abs(centre[:2])))
    tail = [candidate.score, candidate.visible_fraction, candidate.top, wall, candidate.fill]
    return np.concatenate([centre, rotation_6d(T_bin_part[:3, :3]), tail]).astype(np.float32)


def pad_candidates(
    candidates: Sequence[PoseCandidate], workspace: Workspace
) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
    """Return (K, F) features, zero where there is no candidate, and the (K,) mask; the first K candidates are kept."""
    rows = np.zeros((MAX_CANDIDATES, len(FEATURES)), dtype=np.float32)
    mask = np.zeros(MAX_CANDIDATES, dtype=np.int8)
    for k, candidate in enumerate(candidates[:MAX_CANDIDATES]):
        rows[k] = candidate_row(candidate, workspace)
        mask[k] = 1
    return rows, mask
