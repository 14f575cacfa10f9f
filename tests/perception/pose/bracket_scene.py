"""A notched bracket as a wireframe, its pair table, and scenes of it whose pose is known."""

import math

import numpy as np

from perception.geometry import make_transform, random_rotation, transform_points
from perception.part import Symmetry, diameter
from perception.pose.hypotheses.voting import VoteConfig
from perception.pose.model.pair_features import unit
from tests.perception.pose.pair_tables import table_of

STEP = 0.0275  # of d_max between points of an edge
EVERY = VoteConfig(keep=10_000, min_references=1, reference_step=1)


def prism(outline, height, offset=(0.0, 0.0, 0.0)):
    """Return the (E, 2, 3) edges of an outline's prism."""
    low = np.array([(x, y, 0.0) for x, y in outline])
    high = low + np.array([0.0, 0.0, height])
    rings = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in (low, high)]
    return np.concatenate([*rings, np.stack([low, high], axis=1)]) + offset


L = ((0, 0), (0.08, 0), (0.08, 0.012), (0.012, 0.012), (0.012, 0.05), (0, 0.05))
NOTCH = ((0.04, 0.0), (0.06, 0.0), (0.06, 0.006), (0.04, 0.006))
BRACKET = np.concatenate([prism(L, 0.03), prism(NOTCH, 0.01, (0, 0.012, 0.01))])
D = diameter(BRACKET.reshape(-1, 3))


def sample(edges, spacing, phase=0.5):
    """Return points every ``spacing`` along (E, 2, 3) edges, and tangents."""
    points, tangents = [], []
    for a, b in edges:
        length = np.linalg.norm(b - a)
        count = max(round(length / spacing), 1)
        points.append(a + (np.arange(count)[:, None] + phase) / count * (b - a))
        tangents.append(np.tile((b - a) / length, (count, 1)))
    return np.concatenate(points), np.concatenate(tangents)


def bracket_table(config=None, **overrides):
    points, tangents = sample(BRACKET, STEP * D)
    return table_of(points, tangents, np.ones(len(points), np.uint32), D, config, **overrides)


def bracket_scene(rng, *, missing=0.0, clutter=0, offset=0.0, tilt=0.0):
    """Return points, tangents of random sign, the true pose and which points are on the part, all in random order."""
    kept = rng.permutation(len(BRACKET))[: round(len(BRACKET) * (1 - missing))]
    points, tangents = sample(BRACKET[kept], STEP * D * 0.9, 0.3)
    T_cam_part = make_transform(random_rotation(rng), rng.normal((0.0, 0.0, 0.9), 0.1))
    cloud = transform_points(T_cam_part, BRACKET.mean(axis=(0, 1)) + rng.uniform(-0.6, 0.6, (clutter, 3)) * D)
    noise = rng.normal(scale=offset, size=points.shape)
    points = np.concatenate([transform_points(T_cam_part, points) + noise, cloud])
    tangents = np.concatenate([tangents @ T_cam_part[:3, :3].T, unit(rng.normal(size=(clutter, 3)))])
    tangents = unit(tangents + rng.normal(scale=tilt / math.sqrt(2), size=tangents.shape))
    order = rng.permutation(len(points))
    signs = rng.choice([-1.0, 1.0], len(points))[:, None]
    return points[order], (tangents * signs)[order], T_cam_part, (np.arange(len(points)) < len(points) - clutter)[order]


def is_right(raw, T_cam_part, symmetry=None, centre=None, distance=0.05, angle=12):
    """Return (K,) whether each raw pose is within an alpha bin and a cell of the truth."""
    symmetry = symmetry or Symmetry()
    centre = BRACKET.mean(axis=(0, 1)) if centre is None else centre
    turned = np.array([symmetry.distance(T[:3, :3], T_cam_part[:3, :3]) for T in raw.T_cam_part])
    there = raw.T_cam_part[:, :3, :3] @ centre + raw.T_cam_part[:, :3, 3]
    moved = np.linalg.norm(there - transform_points(T_cam_part, centre[None]), axis=1)
    return (turned <= math.radians(angle)) & (moved <= distance * D)


def share_right(raw, T_cam_part, references):
    """Return the share of the references with a right raw pose."""
    return len(np.intersect1d(raw.reference[is_right(raw, T_cam_part)], references)) / len(references)
