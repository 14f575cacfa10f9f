"""Training samples of the context network: the points around one of a scene, at the density of prediction."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.segmentation.networks.hierarchy import Hierarchy, build_hierarchy, level_order, thin, window
from perception.segmentation.training.augment import AugmentConfig, draw_kept, draw_turn
from perception.segmentation.training.packed import PackedScene

RIM = 0.85  # share of the radius of a crop beyond which points are void, as their parts are cut off
DENSITY = (0.7, 1.4)  # least and largest factor of the spacing
FINER = 0.8  # factor of the spacing of a scene with too few points, until there are enough
FINEST = 0.001  # least spacing, in units of d_max; points that are nearer to each other coincide

Singles = NDArray[np.float32]


class ContextSample(NamedTuple):
    """A crop of a scene with N points in the order of their levels.

    Attributes:
        cloud: Points along the rotated camera axes, in units of d_max, with their neighbours.
        instance_ids: (N,) part of each point, -1 for the container and near the rim.
        offsets: (N, 3) offset from each point to the centre of its part, in the axes and unit of the points.
    """

    cloud: Hierarchy
    instance_ids: NDArray[np.int64]
    offsets: Singles


def context_sample(
    scene: PackedScene, count: int, spacing: float, k: int, augment: AugmentConfig, rng: np.random.Generator
) -> ContextSample:
    """Draw a rotated crop of ``count`` points around one of the points of a scene; points are repeated if it has fewer.

    Args:
        scene: Scene to draw from.
        count: Number of points of the sample.
        spacing: Distance of neighbouring points, in units of d_max. It is varied, and finer in scenes of few points.
        k: Number of neighbours.
        augment: Strength of the augmentation.
        rng: Source of the draws.
    """
    turn = draw_turn(augment, rng)
    unit = scene.d_max * (1.0 + rng.uniform(-augment.scale, augment.scale))
    spacing = spacing * rng.uniform(*DENSITY)
    kept = np.nonzero(draw_kept(scene.points, scene.d_max, augment, rng))[0]
    kept = kept if len(kept) else np.arange(len(scene.points))
    points = scene.points[kept].astype(np.float64) / unit
    thinned = thin(points, spacing, rng)
    while len(thinned) < min(count, len(kept)):
        spacing *= FINER
        thinned = thin(points, spacing, rng) if spacing > FINEST else rng.permutation(len(points))
    near = window(points[thinned], int(rng.integers(len(thinned))), count)
    ids = scene.instance_ids[kept[thinned[near]]].astype(np.int64)
    if len(near) < len(thinned):
        ids[_beyond_rim(points[thinned[near]])] = -1
    drawn = rng.permutation(count) % len(near)
    chosen, ids = thinned[near[drawn]], ids[drawn]
    crop = points[chosen]
    to_centre = scene.centres[scene.instance_ids[kept[chosen]]] / unit - crop
    crop = crop - crop.mean(axis=0)
    crop[:, 2] += augment.jitter * rng.standard_normal(count)
    crop[:, :2], to_centre[:, :2] = crop[:, :2] @ turn.T, to_centre[:, :2] @ turn.T
    order = level_order(crop, spacing)
    return ContextSample(
        cloud=build_hierarchy(crop[order], k),
        instance_ids=ids[order],
        offsets=to_centre[order].astype(np.float32),
    )


def _beyond_rim(points: Floats) -> NDArray[np.bool_]:
    """Return the mask of the points near the rim of a crop, which are in order of their distance from the first."""
    squares = np.square(points[:, :2] - points[0, :2]).sum(axis=1)
    return np.asarray(squares > RIM**2 * squares[-1])
