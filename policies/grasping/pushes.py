"""Pushes: closed fingertips press on a part from above and drag it to where there is room for a grasp."""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import cv2
import numpy as np

from perception.geometry import Floats, make_transform, rotation_about
from policies.grasping.clearance import RankSettings, clear_among, clearances
from policies.grasping.grasps import GraspSet
from policies.grasping.gripper import PAD_SIZE, GripperModel
from policies.grasping.heightmap import HeightMap
from policies.grasping.observed_scene import ObservedScene

CLOSED_GAP = 0.001  # distance between the pads during a push [m]
_TIPS = (PAD_SIZE[0] / 2, PAD_SIZE[1])  # half the extent of the closed fingertips across and along the closing [m]
_TOUCHED = 0.002  # depth below the highest point under the fingertips within which the part is touched [m]
_STEP = 0.01  # distance between the places along a push at which room is measured [m]
_DIRECTIONS = 16  # directions that are tried
_YAWS = 4  # orientations of the fingertips that are tried, over half a turn
_TILTS = (0.0, 0.35, 0.7)  # leans of the gripper that are tried [rad]
_STEPPED_OVER = 0.004  # height above a part's underside up to which others are no obstacle for it [m]
_EDGE_CELLS = 4  # number of cells by which obstacles under the part's outline may grow: its edges and noise
_SAME_PLACE = 0.010  # distance between the beginnings of two pushes up to which they are alike [m]
_SAME_WAY = float(np.cos(np.radians(30)))  # cosine of the angle between their ways up to which they are alike
_ENOUGH = 8  # number of clear grasps from which more are not worth a longer way
_WAYS = 4  # ways of a part that are tried
_POINTS = 12  # places on a part that are tried


@dataclass(frozen=True, kw_only=True)
class PushSettings:
    """Whether and how parts without a grasp are pushed. Lengths [m], forces [N]."""

    enabled: bool = True  # whether a part is pushed before the picker gives a bin up
    travel: float = 0.10  # longest way that the fingertips drag a part
    room: float = 0.05  # room around the part from which more is not worth a longer way
    least_gain: float = 0.006  # smallest gain of room for which a push is made
    margin: float = 0.003  # smallest height of the gripper above everything but the part
    press_speed: float = 0.02  # share of the joints' velocity limit allowed on the way down, until the part is felt
    drag_speed: float = 0.03  # the same while the part is dragged
    press_force: float = 20.0  # contact force at which the way down ends
    press_time: float = 0.48  # time in which the fingertips press on the part before they drag it [s]
    # Contact force that the fingertips keep while they drag. A part follows if the pads' friction (0.7) holds more of
    # it than the ground's (0.5), which bears the weight as well: from 2.5 times the weight on.
    drag_force: float = 25.0
    compliance: float = 5e-5  # change of height in a control period for each newton that is missing [m/N]
    largest_change: float = 4e-4  # largest change of height in a control period
    lower: float = 0.012  # largest depth below the planned way
    higher: float = 0.003  # largest height above it
    stop_force: float = 100.0  # contact force at which the push is broken off
    above: float = 0.006  # height above the part from which it is felt for
    depth: float = 0.025  # longest way down from where the part was observed; a leaning part gives way

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self) if field.name != "enabled"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name)}")
        if max(self.press_speed, self.drag_speed) > 1:
            raise ValueError(f"press_speed and drag_speed must be at most 1, got {self.press_speed}, {self.drag_speed}")
        if max(self.press_force, self.drag_force) >= self.stop_force:
            forces = f"{self.press_force}, {self.drag_force} and {self.stop_force}"
            raise ValueError(f"press_force and drag_force must be under stop_force, got {forces} N")


@dataclass(frozen=True, eq=False, kw_only=True)
class Push:
    """A push of one observed part.

    Attributes:
        T_world_tips: (4, 4) frame of the closed fingertips' ends on the part, axes as those of a grasp.
        drag_world: (3,) level way of the fingertips while they press [m].
        candidate: Row of the pose candidate.
        score: Larger is tried first.
    """

    T_world_tips: Floats
    drag_world: Floats
    candidate: int
    score: float

    def resembles(self, other: "Push") -> bool:
        """Return whether another push begins within 10 mm of this one and leads the same way to 30 degrees."""
        if np.linalg.norm(self.T_world_tips[:3, 3] - other.T_world_tips[:3, 3]) > _SAME_PLACE:
            return False
        lengths = float(np.linalg.norm(self.drag_world) * np.linalg.norm(other.drag_world))
        return float(self.drag_world @ other.drag_world) > _SAME_WAY * lengths


def find_pushes(
    scene: ObservedScene,
    grasps: GraspSet,
    gripper: GripperModel,
    settings: PushSettings | None = None,
    rank: RankSettings | None = None,
) -> list[Push]:
    """Return the pushes after which a grasp on an observed part should be clear, best first.

    A part is pressed where it is the highest thing under the fingertips, and dragged straight to where a grasp is clear
    if the part moves as the fingertips do, or else to where the distance from its outline to the walls and to
    everything that stands higher than its lowest point is larger. The gripper stays clear of everything else, at the
    beginning and on the way.

    Args:
        scene: Observed parts with their surroundings.
        grasps: Grasps on this kind of part.
        gripper: Points on the gripper's surfaces.
        settings: Limits; the defaults if None.
        rank: Which grasps are clear; the defaults if None.

    Note:
        Some 50 ms for each part.
    """
    settings, rank = settings or PushSettings(), rank or RankSettings()
    found = [
        push for row in range(len(scene.candidates)) for push in _of_part(scene, row, grasps, gripper, settings, rank)
    ]
    return sorted(found, key=lambda push: -push.score)


def _of_part(
    scene: ObservedScene,
    row: int,
    grasps: GraspSet,
    gripper: GripperModel,
    settings: PushSettings,
    rank: RankSettings,
) -> Iterator[Push]:
    heights, candidate = scene.heights, scene.candidates[row]
    own = heights.rasterise(grasps.surface, candidate.T_world_part)
    if not np.isfinite(own).any():
        return
    T_world_bin = scene.workspace.T_world_bin
    upside_down = T_world_bin @ np.diag([1.0, 1.0, -1.0, 1.0]) @ heights.T_bin_world @ candidate.T_world_part
    underside = -heights.rasterise(grasps.surface, upside_down)
    surroundings = scene.parts[row].surroundings
    places = _places(own, surroundings, settings)
    if not places:
        return
    R_world_bin = heights.T_bin_world[:3, :3].T
    ways = []
    for way_bin, gain in _ways(own, underside, surroundings, settings):
        way_world = R_world_bin @ np.append(way_bin, 0.0)
        moved = make_transform(translation=way_world) @ candidate.T_world_part
        clear = int(clear_among(surroundings, moved, grasps, gripper, rank).sum())
        ways.append(
            (way_bin, way_world, min(clear, _ENOUGH) / _ENOUGH + 0.5 * gain - 2 * float(np.linalg.norm(way_bin)))
        )
    ways = sorted(ways, key=lambda way: -way[2])[:_WAYS]
    for i, j, worth in places:
        centre_bin = np.append(heights.origin + heights.cell * (np.array([i, j]) + 0.5), own[i, j])
        for way_bin, way_world, gain in ways:
            for T_world_tips, tilt in _clear_tips(scene, row, centre_bin, way_bin, gripper, settings):
                score = gain + worth - 0.5 * tilt
                yield Push(T_world_tips=T_world_tips, drag_world=way_world, candidate=row, score=score)


def _ways(
    own: Floats, underside: Floats, surroundings: HeightMap, settings: PushSettings
) -> Iterator[tuple[Floats, float]]:
    """Yield (2,) ways in the bin frame [m] that are free and give room, with the gain of room over the wanted room.

    A way is free where nothing new gets in the part's way: what lies on the part at first may stay on it, and a part
    that lies on others may slide over them.
    """
    cell, inner = surroundings.cell, surroundings.inner
    covered = np.argwhere(np.isfinite(own))
    under = underside[covered[:, 0], covered[:, 1]] + _STEPPED_OVER
    free = np.zeros(surroundings.heights.shape, np.uint8)
    free[covered[:, 0], covered[:, 1]] = 1  # what seems to stand where the part lies is its own edge
    free[inner] |= surroundings.heights[inner] < under.min()
    outside = np.ones(free.shape, np.bool_)
    outside[inner] = False
    free[outside] = 0
    distance = cell * cv2.distanceTransform(np.pad(free, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
    before = float(distance[covered[:, 0], covered[:, 1]].min())
    blocked_before = int((surroundings.heights[covered[:, 0], covered[:, 1]] > under).sum())
    for angle in 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
        direction = np.array([np.cos(angle), np.sin(angle)])
        blocked = blocked_before
        for step in np.arange(_STEP, settings.travel + 1e-9, _STEP):
            moved = covered + np.round(step * direction / cell).astype(int)
            if np.any(moved < 0) or np.any(moved >= free.shape):
                break
            i, j = moved.T
            blocked_now = int((surroundings.heights[i, j] > under).sum())
            if np.any(outside[i, j]) or blocked_now > blocked + _EDGE_CELLS:
                break
            blocked = min(blocked, blocked_now)
            after = float(distance[i, j].min())
            freed = blocked_before > 2 * _EDGE_CELLS and blocked_now <= blocked_before // 2
            if after - before >= settings.least_gain or freed:
                yield step * direction, (min(after, settings.room) - before) / settings.room


def _places(own: Floats, surroundings: HeightMap, settings: PushSettings) -> list[tuple[int, int, float]]:
    """Return cells where the part is the highest thing under the fingertips, with a score of each, best first.

    The score falls with the distance from the part's middle and grows with the share of the fingertips' ends that
    touches the part.
    """
    cell = surroundings.cell
    radius = int(np.ceil(max(_TIPS) / cell))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    highest = cv2.dilate(own, disc)
    others = cv2.dilate(surroundings.heights, disc)
    known = np.isfinite(own)
    usable = known & (own >= highest - _TOUCHED) & (highest > others + settings.margin)
    usable[: surroundings.inner[0].start + radius] = usable[surroundings.inner[0].stop - radius :] = False
    usable[:, : surroundings.inner[1].start + radius] = usable[:, surroundings.inner[1].stop - radius :] = False
    cells = np.argwhere(usable)
    if len(cells) == 0:
        return []
    middle = np.argwhere(known).mean(axis=0)
    extent = np.linalg.norm(np.argwhere(known) - middle, axis=1).max()
    share = np.empty(len(cells))
    for k, (i, j) in enumerate(cells):
        under = own[i - radius : i + radius + 1, j - radius : j + radius + 1][disc.astype(bool)]
        share[k] = float((under >= highest[i, j] - _TOUCHED).mean())
    score = share - np.linalg.norm(cells - middle, axis=1) / max(extent, 1.0)
    chosen: list[tuple[int, int, float]] = []
    for k in np.argsort(-score, kind="stable"):
        i, j = (int(n) for n in cells[k])
        if all(np.hypot(i - a, j - b) * cell > 0.008 for a, b, _ in chosen):
            chosen.append((i, j, float(score[k])))
        if len(chosen) == _POINTS:
            break
    return chosen


def _clear_tips(
    scene: ObservedScene, row: int, centre_bin: Floats, way_bin: Floats, gripper: GripperModel, settings: PushSettings
) -> Iterator[tuple[Floats, float]]:
    """Yield (4, 4) poses of the fingertips at a place from which they can go a way, with their tilts [rad].

    The gripper leans towards where it goes, which is away from the wall.
    """
    surroundings = scene.parts[row].surroundings
    T_world_bin = scene.workspace.T_world_bin
    steps = np.linspace(0.0, 1.0, 4)
    along = np.arctan2(way_bin[1], way_bin[0])
    across = np.array([-np.sin(along), np.cos(along), 0.0])
    for tilt in _TILTS:
        lean = rotation_about(across, tilt)
        for yaw in along + np.pi * np.arange(_YAWS) / _YAWS:
            c, s = np.cos(yaw), np.sin(yaw)
            R_bin_tips = lean @ np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
            moved = np.stack(
                [
                    T_world_bin @ make_transform(R_bin_tips, centre_bin + np.append(way_bin, 0.0) * step)
                    for step in steps
                ]
            )
            gap = np.full(len(moved), CLOSED_GAP)
            room = clearances(surroundings, gripper.tcp_from_grasp(moved, gap), gap, gripper)
            if room.min() >= settings.margin:
                yield moved[0], tilt
                break
