"""Ranking of the grasps on the observed parts that keep the gripper clear of everything else."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from binpick_env.candidates import PoseCandidate
from perception.frame import Workspace
from perception.geometry import Floats, require_shape
from policies.grasping._kernels import scene_clearances, widest_clear
from policies.grasping.grasps import GraspSet
from policies.grasping.gripper import GripperModel
from policies.grasping.heightmap import HeightMap
from policies.grasping.observed_scene import ObservedPart, ObservedScene
from policies.grasping.outcomes import GraspCandidate

RETREATS = (0.02, 0.04, 0.06)  # distances back along the approach at which the gripper is checked [m]


@dataclass(frozen=True, kw_only=True)
class RankSettings:
    """Which grasps are clear, and how clear grasps are ranked. Lengths [m], angles [rad].

    The score is a weighted sum of features in [0, 1]. The weights add up to 1; the penalties are subtracted.
    """

    max_tilt: float = float(np.radians(50))  # largest angle between the approach and the vertical
    margin: float = 0.001  # smallest height of every point of the gripper above everything else that was observed
    max_opening: float = 0.084  # largest distance between the pads on the approach
    cell: float = 0.002  # edge length of a cell of the height map
    per_candidate: int = 8  # largest number of grasps kept of each part
    weight_quality: float = 0.30  # weight of the grasp's quality on the lone part
    weight_vertical: float = 0.10  # weight of the approach: 1 straight down, 0 at max_tilt
    weight_score: float = 0.10  # weight of perception's confidence
    weight_visible: float = 0.10  # weight of the visible fraction
    weight_height: float = 0.25  # weight of the part's height: 1 for the highest part, 0 from 60 mm below it
    weight_wall: float = 0.05  # weight of the fingertips' distance from the nearest wall: 1 from 50 mm
    weight_clearance: float = 0.05  # weight of the smallest clearance beyond the margin: 1 from 5 mm
    weight_opening: float = 0.05  # weight of the share of the tried openings that are as wide or narrower
    penalty_covered: float = 0.30  # penalty for known parts above the target, full from two
    penalty_buried: float = 0.20  # penalty for the share of the target's outline under higher measurements

    def __post_init__(self) -> None:
        if not 0 < self.max_tilt <= np.pi / 2:
            raise ValueError(f"max_tilt must be in (0, pi/2] rad, got {self.max_tilt}")
        for name in ("margin", "max_opening", "cell", "per_candidate"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class RankStats:
    """Where a ranking lost grasps."""

    considered: int = 0  # number of grasps of all candidates
    tilted: int = 0  # number rejected because the approach is tilted too far
    blocked: int = 0  # number rejected because the gripper would touch something else
    clear: int = 0  # number left
    parts: int = 0  # number of candidates
    parts_blocked: int = 0  # number of candidates without any clear grasp


def clearances(
    scene: HeightMap,
    T_world_tcp: Floats,
    opening: Floats,
    gripper: GripperModel,
    *,
    width: Floats | None = None,
    retreats: Sequence[float] = RETREATS,
) -> Floats:
    """Measure how far the gripper stays above the scene.

    Args:
        scene: Heights of everything that must not be touched.
        T_world_tcp: (N, 4, 4) final poses.
        opening: (N,) distance between the pads during the approach [m].
        gripper: Points on the gripper's surfaces.
        width: (N,) distance between the pads at contact [m], to check the closing as well.
        retreats: Distances back along the approach [m] that are checked besides the final pose.

    Returns:
        (N, 3) smallest vertical clearance [m] of left finger, right finger and palm; negative where they penetrate.
    """
    require_shape("T_world_tcp", T_world_tcp, (None, 4, 4))
    require_shape("opening", opening, (len(T_world_tcp),))
    states = [(opening, back) for back in (0.0, *retreats)]
    if width is not None:
        require_shape("width", width, (len(T_world_tcp),))
        states += [((opening + width) / 2, 0.0), (width, 0.0)]
    table = np.stack([np.column_stack([gap, np.full(len(gap), back)]) for gap, back in states], axis=1)
    tables = gripper.gaps, gripper.points, gripper.labels
    found: Floats = scene_clearances(*_cells(scene), scene.T_bin_world @ T_world_tcp, table, *tables)
    return found


def rank_grasps(
    scene: ObservedScene, grasps: GraspSet, gripper: GripperModel, settings: RankSettings | None = None
) -> tuple[list[GraspCandidate], RankStats]:
    """Place the part's grasps on every observed part and keep the best that are clear of everything else.

    Args:
        scene: Observed parts with their surroundings.
        grasps: Grasps on this kind of part.
        gripper: Points on the gripper's surfaces.
        settings: Limits and weights; the defaults if None.

    Returns:
        At most ``per_candidate`` grasps of each part, all together by falling score, and the counts.
    """
    settings, candidates = settings or RankSettings(), scene.candidates
    highest = max((c.top for c in candidates), default=0.0)
    ranked: list[GraspCandidate] = []
    tilted = clear = parts_blocked = 0
    for row, (candidate, part) in enumerate(zip(candidates, scene.parts, strict=True)):
        down = -(grasps.T_part_grasp[:, :3, 2] @ candidate.T_world_part[2, :3])
        upright = np.flatnonzero(down >= np.cos(settings.max_tilt))
        T_world_grasp = candidate.T_world_part @ grasps.T_part_grasp[upright]
        placed = _Placed(grasps=grasps.take(upright), T_world_grasp=T_world_grasp, down=down[upright])
        opening, room = _open(part.surroundings, placed, gripper, settings)
        kept = np.flatnonzero(opening >= 0)
        tilted += len(grasps) - len(upright)
        clear += len(kept)
        parts_blocked += len(kept) == 0
        if len(kept) > 0:
            shared = _shared_features(candidate, highest, part)
            found = _Clear(placed=placed, kept=kept, opening=opening[kept], room=room[kept])
            ranked += _best(found, row, shared, scene.workspace, gripper, settings)
    considered = len(candidates) * len(grasps)
    stats = RankStats(
        considered=considered,
        tilted=tilted,
        blocked=considered - tilted - clear,
        clear=clear,
        parts=len(candidates),
        parts_blocked=parts_blocked,
    )
    return sorted(ranked, key=lambda g: -g.score), stats


def clear_of_floor(
    T_floor_part: Floats, grasps: GraspSet, gripper: GripperModel, settings: RankSettings | None = None
) -> NDArray[np.bool_]:
    """Tell which grasps pick a lone part off a plane without touching the plane.

    Args:
        T_floor_part: (4, 4) pose of the part over the plane z = 0 [m].
        grasps: Grasps on the part.
        gripper: Points on the gripper's surfaces.
        settings: Largest tilt of the approach, and the margin; the defaults if None.

    Returns:
        (G,) whether each grasp is within the largest tilt and clear at some opening.
    """
    require_shape("T_floor_part", T_floor_part, (4, 4))
    return clear_among(HeightMap.plane(), T_floor_part, grasps, gripper, settings)


def clear_among(
    surroundings: HeightMap,
    T_world_part: Floats,
    grasps: GraspSet,
    gripper: GripperModel,
    settings: RankSettings | None = None,
) -> NDArray[np.bool_]:
    """Tell which grasps on one part are clear of its surroundings.

    Args:
        surroundings: Heights of everything but the part.
        T_world_part: (4, 4) pose of the part.
        grasps: Grasps on the part.
        gripper: Points on the gripper's surfaces.
        settings: Largest tilt of the approach, and the margin; the defaults if None.

    Returns:
        (G,) whether each grasp is within the largest tilt and clear at some opening.
    """
    settings = settings or RankSettings()
    down = -(grasps.T_part_grasp[:, :3, 2] @ T_world_part[2, :3])
    upright = np.flatnonzero(down >= np.cos(settings.max_tilt))
    T_world_grasp = T_world_part @ grasps.T_part_grasp[upright]
    placed = _Placed(grasps=grasps.take(upright), T_world_grasp=T_world_grasp, down=down[upright])
    opening, _ = _open(surroundings, placed, gripper, settings)
    clear = np.zeros(len(grasps), dtype=np.bool_)
    clear[upright] = opening >= 0
    return clear


@dataclass(frozen=True, eq=False, kw_only=True)
class _Placed:
    """The N grasps on one observed part whose approach is steep enough."""

    grasps: GraspSet
    T_world_grasp: Floats  # (N, 4, 4)
    down: Floats  # (N,) cosine of the angle between approach and vertical


@dataclass(frozen=True, eq=False, kw_only=True)
class _Clear:
    """The M of N placed grasps that are clear of everything else."""

    placed: _Placed
    kept: NDArray[np.int64]  # (M,) index into the placed grasps
    opening: NDArray[np.int64]  # (M,) index into the tried openings
    room: Floats  # (M,) smallest clearance [m]


def _open(
    scene: HeightMap, placed: _Placed, gripper: GripperModel, settings: RankSettings
) -> tuple[NDArray[np.int64], Floats]:
    """Return the (N,) index of the widest clear opening, -1 for none, and the (N,) smallest clearance [m]."""
    grasps = placed.grasps
    T_bin_tcp = scene.T_bin_world @ gripper.tcp_from_grasp(placed.T_world_grasp, grasps.width)
    fits = grasps.width[:, None] + 2 * grasps.extras <= min(settings.max_opening, gripper.stroke)
    openings = grasps.width, grasps.extras, grasps.clear & fits, np.array(RETREATS)
    tables = gripper.gaps, gripper.points, gripper.labels
    found: tuple[NDArray[np.int64], Floats] = widest_clear(
        *_cells(scene), T_bin_tcp, *openings, *tables, settings.margin
    )
    return found


def _cells(scene: HeightMap) -> tuple[Floats, Floats, float, float]:
    return scene.heights, scene.origin, scene.cell, scene.outside


def _shared_features(candidate: PoseCandidate, highest: float, part: ObservedPart) -> dict[str, float]:
    """Return the features that all grasps of one part have in common."""
    return {
        "score": candidate.score,
        "visible": candidate.visible_fraction,
        "height": float(np.clip(1 - (highest - candidate.top) / 0.06, 0, 1)),
        "covered": min(part.covering, 2) / 2,
        "buried": part.buried,
    }


def _best(
    found: _Clear,
    row: int,
    shared: dict[str, float],
    workspace: Workspace,
    gripper: GripperModel,
    settings: RankSettings,
) -> list[GraspCandidate]:
    """Score the clear grasps on one part and keep the best that differ from each other."""
    placed, kept = found.placed, found.kept
    T_world_grasp, grasps = placed.T_world_grasp[kept], placed.grasps
    least = np.cos(settings.max_tilt)
    beside = workspace.inner_size[:2] / 2 - np.abs(workspace.to_bin(T_world_grasp[:, :3, 3])[:, :2])
    features = {
        "quality": grasps.quality[kept],
        "vertical": (placed.down[kept] - least) / max(1 - least, 1e-9),
        "wall": np.clip(beside.min(axis=1) / 0.05, 0, 1),
        "clearance": np.clip((found.room - settings.margin) / 0.005, 0, 1),
        "opening": (found.opening + 1) / len(grasps.extras),
        **{name: np.full(len(kept), value) for name, value in shared.items()},
    }
    score = sum(getattr(settings, f"weight_{name}", 0.0) * value for name, value in features.items())
    score = score - sum(getattr(settings, f"penalty_{name}") * features[name] for name in ("covered", "buried"))
    T_world_tcp = gripper.tcp_from_grasp(T_world_grasp, grasps.width[kept])
    opening = grasps.width[kept] + 2 * grasps.extras[found.opening]
    return [
        GraspCandidate(
            T_world_grasp=T_world_grasp[n],
            T_world_tcp=T_world_tcp[n],
            width=float(grasps.width[kept[n]]),
            opening=float(opening[n]),
            candidate=row,
            score=float(score[n]),
            features={name: float(value[n]) for name, value in features.items()},
        )
        for n in _diverse(T_world_grasp, score, settings.per_candidate)
    ]


def _diverse(T_world_grasp: Floats, score: Floats, count: int) -> list[int]:
    """Return up to ``count`` indices by falling score, all 10 mm or 20 degrees apart."""
    order = np.argsort(-score, kind="stable")
    T = T_world_grasp[order]
    free = np.ones(len(order), dtype=np.bool_)
    chosen: list[int] = []
    while len(chosen) < count and np.any(free):
        n = int(np.argmax(free))
        chosen.append(int(order[n]))
        near = np.linalg.norm(T[:, :3, 3] - T[n, :3, 3], axis=1) < 0.010
        near &= T[:, :3, 2] @ T[n, :3, 2] > np.cos(np.radians(20))
        near &= np.abs(T[:, :3, 1] @ T[n, :3, 1]) > np.cos(np.radians(20))  # the flipped jaw counts as the same
        free &= ~near
        free[n] = False
    return chosen
