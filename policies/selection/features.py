"""Features of grasp candidates: one row of bounded numbers per grasp, in the bin's frame."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from binpick_env.candidates import MAX_CANDIDATES
from perception.geometry import Floats, invert_transform, require_shape
from policies.grasping.clearance import RankSettings, clearances
from policies.grasping.failed_grasps import FailedGrasps
from policies.grasping.gripper import GripperModel
from policies.grasping.observed_scene import ObservedScene
from policies.grasping.outcomes import GraspCandidate

FULL_CLEARANCE = 0.02  # clearance beyond the margin that maps to 1 [m]
FULL_DEXTERITY = 0.3  # smallest singular value of the Jacobian that maps to 1; the cell's best posture has 0.26


@dataclass(frozen=True, kw_only=True)
class Feature:
    """One column of an observation.

    Attributes:
        low: Lower end of the range, at most 0 because empty rows are zero.
        high: Upper end of the range.
        meaning: Quantity that the column holds.
    """

    low: float
    high: float
    meaning: str


def _signed(meaning: str) -> Feature:
    return Feature(low=-1.0, high=1.0, meaning=meaning)


def _share(meaning: str) -> Feature:
    return Feature(low=0.0, high=1.0, meaning=meaning)


FEATURES: dict[str, Feature] = {
    "x": _signed("x of the fingertips' midpoint at contact, bin frame, divided by half the bin's length"),
    "y": _signed("y of the fingertips' midpoint at contact, bin frame, divided by half the bin's width"),
    "z": _share("height of the fingertips' midpoint above the floor, divided by twice the bin's depth"),
    "approach_x": _signed("x of the unit approach direction, bin frame"),
    "approach_y": _signed("y of the unit approach direction, bin frame"),
    "approach_z": _signed("z of the unit approach direction, bin frame; -1 is straight down"),
    "closing_x": _signed("x of the unit closing direction, bin frame; not negative, since the jaw is symmetric"),
    "closing_y": _signed("y of the unit closing direction, bin frame; not negative if x is 0"),
    "closing_z": _signed("z of the unit closing direction, bin frame"),
    "quality": _share("quality of the grasp on the isolated part"),
    "vertical": _share("tilt of the approach, by its cosine: 1 straight down, 0 at the largest tilt allowed"),
    "score": _share("perception's confidence in the part's pose"),
    "visible": _share("visible fraction of the part"),
    "height": _share("height of the part: 1 for the highest, 0 from 60 mm below it"),
    "wall": _share("distance of the fingertips from the nearest wall: 1 from 50 mm"),
    "clearance": _share("smallest clearance of the gripper: 0 at the margin, 1 from 5 mm more"),
    "opening": _share("share of the tried jaw openings that are at most as wide as this one"),
    "covered": _share("number of observed parts above this one: 0, 1/2 for one, 1 from two"),
    "buried": _share("share of the part's outline over which something higher was measured"),
    "clearance_back": _share(
        "clearance of the finger behind the closing direction: 0 at the margin, 1 from 20 mm more"
    ),
    "clearance_front": _share(
        "clearance of the finger ahead of the closing direction: 0 at the margin, 1 from 20 mm more"
    ),
    "clearance_palm": _share("clearance of the rest of the gripper: 0 at the margin, 1 from 20 mm more"),
    "width": _share("distance between the pads at contact, divided by the stroke"),
    "gap": _share("distance between the pads during the approach, divided by the stroke"),
    "top": _share("height of the part's highest point above the floor, divided by twice the bin's depth"),
    "offset": _share("distance of the part's centre from the fingertips' midpoint, divided by half the part's d_max"),
    "fill": _share("number of visible boundary points of the part, divided by P"),
    "dexterity": _share("smallest singular value of the tcp's Jacobian at the grasp, divided by 0.3"),
    "suspect": _share("1 if an earlier attempt on this part failed"),
    "seen": _share("number of parts observed in this frame, divided by 32"),
    "rank": _signed("weighted score of the scripted picker"),
}
RANKED = ("quality", "vertical", "score", "visible", "height", "wall", "clearance", "opening", "covered", "buried")
LOW = np.array([f.low for f in FEATURES.values()], dtype=np.float32)  # (F,)
HIGH = np.array([f.high for f in FEATURES.values()], dtype=np.float32)  # (F,)


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspScene:
    """The scene that the features of grasps are computed in.

    Attributes:
        seen: Observed parts, and the heights that the gripper must stay above.
        d_max: Diameter of the part [m].
        gripper: Geometry of the gripper.
        rank: Settings by which the grasps were ranked.
        failed: Grasps that were attempted without a delivery.
    """

    seen: ObservedScene
    d_max: float
    gripper: GripperModel
    rank: RankSettings
    failed: FailedGrasps


def feature_rows(scene: GraspScene, grasps: Sequence[GraspCandidate], dexterity: Floats) -> NDArray[np.float32]:
    """Compute the features of grasps, clipped to their ranges.

    Args:
        scene: Observed scene.
        grasps: N ranked grasps.
        dexterity: (N,) smallest singular values of the Jacobian in the postures that reach the grasps.

    Returns:
        (N, F) float32 features in the order of :data:`FEATURES`.
    """
    require_shape("dexterity", dexterity, (len(grasps),))
    if not grasps:
        return np.zeros((0, len(FEATURES)), dtype=np.float32)
    candidates = [scene.seen.candidates[grasp.candidate] for grasp in grasps]
    stroke, depth = scene.gripper.stroke, float(scene.seen.workspace.inner_size[2])
    tips = np.stack([grasp.T_world_grasp[:3, 3] for grasp in grasps])
    centres = np.stack([candidate.centre_world for candidate in candidates])
    columns = {
        **{name: _array(grasp.features[name] for grasp in grasps) for name in RANKED},
        **_hand_pose(scene, grasps),
        **_finger_clearances(scene, grasps),
        "width": _array(grasp.width / stroke for grasp in grasps),
        "gap": _array(grasp.opening / stroke for grasp in grasps),
        "top": _array(candidate.top / (2 * depth) for candidate in candidates),
        "offset": np.linalg.norm(centres - tips, axis=1) / (scene.d_max / 2),
        "fill": _array(candidate.fill for candidate in candidates),
        "dexterity": dexterity / FULL_DEXTERITY,
        "suspect": _array(scene.failed.suspect(centre) for centre in centres),
        "seen": np.full(len(grasps), len(scene.seen.candidates) / MAX_CANDIDATES),
        "rank": _array(grasp.score for grasp in grasps),
    }
    rows = np.stack([columns[name] for name in FEATURES], axis=1).astype(np.float32)
    return np.clip(rows, LOW, HIGH)


def column(name: str) -> int:
    """Return the index of a feature."""
    if name not in FEATURES:
        raise ValueError(f"there is no feature {name!r}; there are {', '.join(FEATURES)}")
    return list(FEATURES).index(name)


def _array(values: Iterable[float]) -> Floats:
    return np.array(list(values), dtype=np.float64)


def _hand_pose(scene: GraspScene, grasps: Sequence[GraspCandidate]) -> dict[str, Floats]:
    """Return the fingertips' midpoint and the hand's directions, bin frame."""
    T_bin_grasp = invert_transform(scene.seen.workspace.T_world_bin) @ np.stack([g.T_world_grasp for g in grasps])
    length, across, depth = scene.seen.workspace.inner_size
    places = T_bin_grasp[:, :3, 3] / np.array([length / 2, across / 2, 2 * depth])
    closing = T_bin_grasp[:, :3, 1] * np.where(_is_negative(T_bin_grasp), -1.0, 1.0)[:, None]
    vectors = {"approach": T_bin_grasp[:, :3, 2], "closing": closing}
    return {
        **{axis: places[:, k] for k, axis in enumerate("xyz")},
        **{f"{name}_{axis}": vector[:, k] for name, vector in vectors.items() for k, axis in enumerate("xyz")},
    }


def _is_negative(T_bin_grasp: Floats) -> NDArray[np.bool_]:
    """Return (N,) whether the closing direction's sign has to be reversed for x to be not negative."""
    x, y = T_bin_grasp[:, 0, 1], T_bin_grasp[:, 1, 1]
    negative: NDArray[np.bool_] = (x < -1e-9) | ((np.abs(x) <= 1e-9) & (y < 0))
    return negative


def _finger_clearances(scene: GraspScene, grasps: Sequence[GraspCandidate]) -> dict[str, Floats]:
    """Return the clearances of both fingers and of the palm, over approach and closing."""
    T_world_tcp = np.stack([grasp.T_world_tcp for grasp in grasps])
    opening, width = _array(grasp.opening for grasp in grasps), _array(grasp.width for grasp in grasps)
    owner = np.array([grasp.candidate for grasp in grasps])
    gaps = np.empty((len(grasps), 3))
    for row in np.unique(owner):
        own, surroundings = owner == row, scene.seen.parts[row].surroundings
        gaps[own] = clearances(surroundings, T_world_tcp[own], opening[own], scene.gripper, width=width[own])
    negative = _is_negative(invert_transform(scene.seen.workspace.T_world_bin) @ T_world_tcp)
    gaps[negative, :2] = gaps[negative, 1::-1]
    shares = (gaps - scene.rank.margin) / FULL_CLEARANCE
    return {f"clearance_{name}": shares[:, k] for k, name in enumerate(("back", "front", "palm"))}
