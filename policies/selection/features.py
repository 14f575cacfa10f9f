"""What a selector sees of a grasp: one row of bounded numbers each, in the bin's frame."""

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

ROOMY = 0.02  # clearance beyond the margin that counts as all one could want [m]
DEXTROUS = 0.3  # smallest singular value of the Jacobian that counts as such; the cell's best posture has 0.26


@dataclass(frozen=True, kw_only=True)
class Feature:
    """One column: its range, which holds 0 because empty rows are zero, and its meaning."""

    low: float
    high: float
    meaning: str


def _signed(meaning: str) -> Feature:
    return Feature(low=-1.0, high=1.0, meaning=meaning)


def _share(meaning: str) -> Feature:
    return Feature(low=0.0, high=1.0, meaning=meaning)


FEATURES: dict[str, Feature] = {
    "x": _signed("midpoint between the fingertips at contact, over half the bin's length"),
    "y": _signed("over half its width"),
    "z": _share("above the floor, over twice its depth"),
    "approach_x": _signed("approach direction, bin frame"),
    "approach_y": _signed("likewise"),
    "approach_z": _signed("likewise; -1 is straight down"),
    "closing_x": _signed("closing direction, bin frame; the jaw has no sign: turned to where x is not negative"),
    "closing_y": _signed("likewise; not negative where x is 0"),
    "closing_z": _signed("likewise"),
    "quality": _share("of the grasp on the lone part"),
    "vertical": _share("cosine of the approach's tilt: 1 straight down, 0 at the largest tilt allowed"),
    "score": _share("perception's confidence in the part's pose"),
    "visible": _share("visible fraction of the part"),
    "height": _share("of the part: 1 for the highest, 0 from 60 mm below it"),
    "wall": _share("distance of the fingertips to the nearest wall: 1 from 50 mm"),
    "clearance": _share("smallest of the whole gripper: 0 at the margin, 1 from 5 mm more"),
    "opening": _share("share of the openings that are as wide as this or narrower"),
    "covered": _share("known parts above this one: 0, 1/2 for one, 1 from two"),
    "buried": _share("share of the part's outline over which something higher was measured"),
    "clearance_back": _share("of the finger on the side that the closing direction comes from: 1 from 20 mm"),
    "clearance_front": _share("of the finger on the side that it points to; likewise"),
    "clearance_palm": _share("of the rest of the gripper; likewise"),
    "width": _share("between the pads at contact, over the stroke"),
    "gap": _share("between the pads on the way in, over the stroke"),
    "top": _share("the part's highest point above the floor, over twice the bin's depth"),
    "offset": _share("distance of the part's centre from the fingertips' midpoint, over half the part's d_max"),
    "fill": _share("visible boundary points of the part over P"),
    "dexterity": _share("of the arm in the grasp: smallest singular value of the tcp's Jacobian over 0.3"),
    "suspect": _share("1 if an attempt on this part failed before"),
    "seen": _share("parts seen in this frame, over 32"),
    "rank": _signed("weighted score of the scripted picker"),
}
RANKED = ("quality", "vertical", "score", "visible", "height", "wall", "clearance", "opening", "covered", "buried")
LOW = np.array([f.low for f in FEATURES.values()], dtype=np.float32)  # (F,)
HIGH = np.array([f.high for f in FEATURES.values()], dtype=np.float32)  # (F,)


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspScene:
    """What the features of grasps are measured in.

    Attributes:
        seen: The parts seen, and what the gripper must stay above.
        d_max: The part's diameter [m].
        gripper: Where its surfaces are.
        rank: Settings that the grasps were ranked with.
        failed: What was tried in vain.
    """

    seen: ObservedScene
    d_max: float
    gripper: GripperModel
    rank: RankSettings
    failed: FailedGrasps


def feature_rows(scene: GraspScene, grasps: Sequence[GraspCandidate], dexterity: Floats) -> NDArray[np.float32]:
    """Measure grasps, clipped to the features' ranges.

    Args:
        scene: Where they are.
        grasps: N of them, ranked.
        dexterity: (N,) smallest singular values of the Jacobian in the postures that reach them.

    Returns:
        (N, F) in the order of :data:`FEATURES`.
    """
    require_shape("dexterity", dexterity, (len(grasps),))
    if not grasps:
        return np.zeros((0, len(FEATURES)), dtype=np.float32)
    candidates = [scene.seen.candidates[grasp.candidate] for grasp in grasps]
    stroke, depth = scene.gripper.stroke, float(scene.seen.workspace.inner_size[2])
    tips = np.stack([grasp.T_world_grasp[:3, 3] for grasp in grasps])
    centres = np.stack([candidate.centre_world for candidate in candidates])
    columns = {
        **{name: _of(grasp.features[name] for grasp in grasps) for name in RANKED},
        **_place(scene, grasps),
        **_room(scene, grasps),
        "width": _of(grasp.width / stroke for grasp in grasps),
        "gap": _of(grasp.opening / stroke for grasp in grasps),
        "top": _of(candidate.top / (2 * depth) for candidate in candidates),
        "offset": np.linalg.norm(centres - tips, axis=1) / (scene.d_max / 2),
        "fill": _of(candidate.fill for candidate in candidates),
        "dexterity": dexterity / DEXTROUS,
        "suspect": _of(scene.failed.suspect(centre) for centre in centres),
        "seen": np.full(len(grasps), len(scene.seen.candidates) / MAX_CANDIDATES),
        "rank": _of(grasp.score for grasp in grasps),
    }
    rows = np.stack([columns[name] for name in FEATURES], axis=1).astype(np.float32)
    return np.clip(rows, LOW, HIGH)


def column(name: str) -> int:
    """Return the index of a feature."""
    if name not in FEATURES:
        raise ValueError(f"there is no feature {name!r}; there are {', '.join(FEATURES)}")
    return list(FEATURES).index(name)


def _of(values: Iterable[float]) -> Floats:
    return np.array(list(values), dtype=np.float64)


def _place(scene: GraspScene, grasps: Sequence[GraspCandidate]) -> dict[str, Floats]:
    """Return where the fingertips meet and how the hand is turned."""
    T_bin_grasp = invert_transform(scene.seen.workspace.T_world_bin) @ np.stack([g.T_world_grasp for g in grasps])
    length, across, depth = scene.seen.workspace.inner_size
    places = T_bin_grasp[:, :3, 3] / np.array([length / 2, across / 2, 2 * depth])
    closing = T_bin_grasp[:, :3, 1] * np.where(_backwards(T_bin_grasp), -1.0, 1.0)[:, None]
    vectors = {"approach": T_bin_grasp[:, :3, 2], "closing": closing}
    return {
        **{axis: places[:, k] for k, axis in enumerate("xyz")},
        **{f"{name}_{axis}": vector[:, k] for name, vector in vectors.items() for k, axis in enumerate("xyz")},
    }


def _backwards(T_bin_grasp: Floats) -> NDArray[np.bool_]:
    """Return (N,) whether the closing direction has to be turned round for its sign to be the agreed one."""
    x, y = T_bin_grasp[:, 0, 1], T_bin_grasp[:, 1, 1]
    backwards: NDArray[np.bool_] = (x < -1e-9) | ((np.abs(x) <= 1e-9) & (y < 0))
    return backwards


def _room(scene: GraspScene, grasps: Sequence[GraspCandidate]) -> dict[str, Floats]:
    """Return the clearances of both fingers and of the palm, of the way in and of the closing."""
    T_world_tcp = np.stack([grasp.T_world_tcp for grasp in grasps])
    opening, width = _of(grasp.opening for grasp in grasps), _of(grasp.width for grasp in grasps)
    owner = np.array([grasp.candidate for grasp in grasps])
    room = np.empty((len(grasps), 3))
    for row in np.unique(owner):
        own, free = owner == row, scene.seen.parts[row].surroundings
        room[own] = clearances(free, T_world_tcp[own], opening[own], scene.gripper, width=width[own])
    backwards = _backwards(invert_transform(scene.seen.workspace.T_world_bin) @ T_world_tcp)
    room[backwards, :2] = room[backwards, 1::-1]
    shares = (room - scene.rank.margin) / ROOMY
    return {f"clearance_{name}": shares[:, k] for k, name in enumerate(("back", "front", "palm"))}
