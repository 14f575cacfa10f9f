"""The pose of a bin in a frame, from its depth."""

from dataclasses import dataclass, replace

import numpy as np

from perception.bin.bin_fit import BinFit, BinSurface
from perception.bin.cloud import GridCloud
from perception.bin.edges import AssumedRim, RimEdges, find_edges
from perception.bin.first_guess import FirstGuess, Prior, find_table, guess_from_floor, guess_from_rim
from perception.bin.height import OTHER_HEIGHT, lowest_level
from perception.bin.judgement import (
    is_another_size,
    least_height,
    opening_of,
    size_in_mm,
    uncertainty,
    why_unreliable,
)
from perception.bin.refinement import EDGE, WALLS, BinState, Refined, SurfacePoints, collect_points, lowered, refine
from perception.frame import Frame, Workspace
from perception.geometry import Floats, invert_transform, make_transform, require_shape

_FEWEST_POINTS = 300  # number of points of the coarse grid with which nothing is looked for
_REACH = 0.015  # distance up to which edges are looked for around an opening that was seen as a whole [m]
_WIDE_REACH = 0.06  # the same around the opening of the bin as it is believed to be [m]
_NEAR_REACH = 0.005  # the same around a refined opening [m]
_LARGEST = 10.0  # length [m] of no opening, but of one in a depth whose unit is wrong
_WHOLE, _LEAST_AREA = 0.9, 0.2  # least share of a whole opening's outline with a rim, and of the stated area
_KEPT = 1e-5  # standard deviation of what the points cannot tell, and is kept [m and rad]
_NO_OPENING = np.full(2, np.nan)


def find_bin(frame: Frame, inner_size: Floats | None, near: Workspace | None = None) -> BinFit:
    """Return the pose of a bin as the depth of a frame shows it, whether it is full or empty.

    The top of the rim gives height and tilt, its inner edges give position and turn, and floor and inner faces of the
    walls count where they are seen. One rigid pose is fitted to all of them at once. A table has a floor only. Where
    the floor is seen more than a centimetre below where the stated height puts it, the measured height counts. A level
    above it may be a layer of parts, and is told by ``height`` alone.

    Args:
        frame: Frame of the camera; its grey image plays no part.
        inner_size: (3,) inner length, width and height [m]; None to measure them, too.
        near: The bin as it is believed to be, up to some centimetres and degrees off; None to look for the largest
            opening in the frame, whose x axis then points to the right in the image, within 45 degrees.

    Returns:
        The fit. If too little is seen, it is not reliable, says why, and has the pose of ``near``.

    Raises:
        ValueError: ``inner_size`` is not (3,) and positive.

    Note:
        Deterministic.
    """
    if inner_size is not None:
        inner_size = np.asarray(inner_size, np.float64)
        require_shape("inner_size", inner_size, (3,))
        if not np.all((inner_size > 0) & (inner_size < np.inf)):
            raise ValueError(f"inner_size must be positive and finite, got {inner_size.tolist()}")
    T_cam_world = invert_transform(frame.T_world_cam)
    prior = Prior(
        inner_size=inner_size,
        T_cam_bin=None if near is None else T_cam_world @ near.T_world_bin,
        extent=None if near is None else near.inner_size[:2],
    )
    cloud = GridCloud.of(frame)
    if len(cloud.points_cam) < _FEWEST_POINTS:
        return _unknown(near, inner_size, "hardly any pixel has a depth")
    rng = np.random.default_rng(0)
    found = _measured_bin(frame, cloud, prior, rng)
    if found is None and near is None and inner_size is None:
        return _table(frame, cloud, rng)
    if found is None or found.reason is not None:
        found = _of_other_height(frame, cloud, prior) or found
    if found is None:
        return _other_opening(_unknown(near, inner_size, "its rim was not found"), cloud, rng)
    found = _named(found, cloud, prior)
    if found.reason is not None:
        unknown = replace(
            _unknown(near, inner_size, found.reason), opening=found.opening, height=found.suggested_height
        )
        return unknown if np.isfinite(found.opening).any() else _other_opening(unknown, cloud, rng)
    refined = found.refined
    walls = any(refined.points[name] > 0 for name in WALLS)
    translation_std, rotation_std = uncertainty(refined, walls)
    return BinFit(
        T_world_bin=frame.T_world_cam @ refined.state.T_cam_bin,
        inner_size=found.inner_size,
        opening=found.opening,
        height=found.height,
        translation_std=translation_std,
        rotation_std=rotation_std,
        points=refined.points,
        residual=refined.residual,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Found:
    """A refined bin.

    Attributes:
        refined: The bin.
        opening: (2,) measured length and width of its opening [m], or NaN.
        height: Height of its rim above the lowest level seen [m]; NaN where rim or level were not seen.
        other: Whether this height was taken in place of the stated one.
        reason: Why it cannot be believed; None if it can.
        suggested_height: Height that the frame suggests for a bin that cannot be believed [m]; NaN without.
    """

    refined: Refined
    opening: Floats
    height: float
    other: bool = False
    reason: str | None = None
    suggested_height: float = float("nan")

    @property
    def inner_size(self) -> Floats:
        """(3,) inner length, width and height [m]."""
        size = self.refined.state.size
        return np.array([*size[:2], self.height]) if self.other else size


def _measured_bin(frame: Frame, cloud: GridCloud, prior: Prior, rng: np.random.Generator) -> _Found | None:
    """Return the bin that fits the points best, by its rim or by its floor alone; None if neither is found."""
    guess = guess_from_rim(cloud, prior, rng)
    refined, edges = (None, None) if guess is None else _refine(frame, cloud, guess)
    if guess is None or edges is None or np.isnan(edges.offsets).all():
        guess = guess_from_floor(cloud, prior, rng)
        refined, edges = (None, None) if guess is None else _refine(frame, cloud, guess)
    if refined is None:
        return None
    found = _at_floor(frame, cloud, refined, edges)
    return replace(found, reason=why_unreliable(found.refined, found.opening, cloud, prior))


def _at_floor(frame: Frame, cloud: GridCloud, refined: Refined, edges: RimEdges | None) -> _Found:
    """Return a refined bin, refined anew with another height if its floor is seen elsewhere than stated."""
    state, other = refined.state, False
    floor_seen = refined.points["floor"] > 0
    height = float(state.size[2]) + state.lift if floor_seen else float("nan")
    if edges is None or refined.points["rim"] == 0:
        return _Found(refined=refined, opening=opening_of(refined, edges), height=float("nan"))
    level = None if state.free else lowest_level(cloud, state, floor_seen=floor_seen)
    if level is not None:
        height = float(state.size[2]) + state.lift - level
        if level < -OTHER_HEIGHT:  # a higher one may be a layer of parts, which would be taken for the floor
            T_cam_bin = state.T_cam_bin @ make_transform(translation=(0.0, 0.0, level))
            size = np.array([*state.size[:2], height])
            moved = BinState(T_cam_bin=T_cam_bin, size=size, noise=state.noise)
            refined, edges = _refine(frame, cloud, FirstGuess(state=moved, rim=True, whole=True))
            height, other = height + refined.state.lift, True
    return _Found(refined=refined, opening=opening_of(refined, edges), height=height, other=other)


def _of_other_height(frame: Frame, cloud: GridCloud, prior: Prior) -> _Found | None:
    """Return the bin of the stated length and width whose rim is not where the stated height puts it; None without."""
    T_cam_believed, stated = prior.T_cam_bin, prior.inner_size
    if T_cam_believed is None or stated is None:
        return None
    prior = replace(prior, height_known=False)
    guess = guess_from_rim(cloud, prior, np.random.default_rng(0))
    refined, edges = (None, None) if guess is None else _refine(frame, cloud, guess)
    if refined is None or edges is None or np.isnan(edges.offsets).all():
        return None
    found = _at_floor(frame, cloud, refined, edges)
    if found.other:
        return found if why_unreliable(found.refined, found.opening, cloud, prior) is None else None
    T_believed_bin = invert_transform(T_cam_believed) @ found.refined.state.T_cam_bin
    aside = float(T_believed_bin[2, 3]) + found.refined.state.lift  # of the rim from where it is said to be
    if is_another_size(found.opening, stated[:2]) or abs(aside) <= OTHER_HEIGHT:
        return None
    side, height = "above" if aside > 0 else "below", float(stated[2]) + aside
    reason = f"its rim lies {1000 * abs(aside):.0f} mm {side} where its pose and the stated height put it"
    return replace(found, reason=reason, suggested_height=height if height > 0 else float("nan"))


def _named(found: _Found, cloud: GridCloud, prior: Prior) -> _Found:
    """Return a bin with what is wrong with its stated size, if that is why it cannot be believed."""
    if prior.inner_size is None:
        return found
    if np.isnan(found.opening).any():
        seen = _whole_opening(cloud, prior)
        if seen is not None and is_another_size(seen, prior.inner_size[:2]):
            return replace(
                found, opening=seen, reason=_other_size(seen, prior.inner_size[:2]), suggested_height=float("nan")
            )
    known = np.isfinite(found.suggested_height) or is_another_size(found.opening, prior.inner_size[:2])
    if found.reason is None or known:
        return found
    return replace(found, suggested_height=least_height(found.refined, cloud))


def _refine(frame: Frame, cloud: GridCloud, guess: FirstGuess) -> tuple[Refined, RimEdges | None]:
    """Refine a guess on all surfaces, whose points are collected anew in each pass."""
    state, edges = guess.state, None
    reaches = (_REACH, _NEAR_REACH) if guess.whole else (_WIDE_REACH, _REACH, _NEAR_REACH)
    for k, reach in enumerate(reaches):
        if guess.rim:
            height = float(state.size[2]) + state.lift
            assumed = AssumedRim(T_cam_bin=state.T_cam_bin, opening=state.opening, height=height, noise=state.noise)
            edges = find_edges(frame, assumed, reach)
        last = k == len(reaches) - 1
        on = collect_points(cloud, state, edges, faces=last and edges is not None)
        start = state if edges is None else lowered(state, on.floor)
        refined = refine(start, on, _prior_std(on))
        state = refined.state if not state.free else _measured(refined.state)
    return refined, edges


def _prior_std(on: SurfacePoints) -> Floats:
    """Return the (6,) standard deviations of the prior of a pose: infinite for what the points tell."""
    counts = np.bincount(on.kinds, minlength=EDGE + 8)
    lengthwise, across = (counts[[EDGE + k, EDGE + k + 1, EDGE + k + 4, EDGE + k + 5]].sum() for k in (0, 2))
    level = counts[:EDGE].sum()
    told = np.array([lengthwise, across, level, level, level, lengthwise + across]) > 0
    return np.where(told, np.inf, _KEPT)


def _measured(state: BinState) -> BinState:
    """Return a bin whose size is the measured one."""
    size = np.array([*state.opening, state.size[2] + state.lift])
    return BinState(T_cam_bin=state.T_cam_bin, size=size, noise=state.noise, free=True)


def _unknown(near: Workspace | None, inner_size: Floats | None, reason: str) -> BinFit:
    """Return a fit that is not reliable."""
    size = inner_size if inner_size is not None or near is None else near.inner_size
    return BinFit(
        T_world_bin=None if near is None else near.T_world_bin,
        inner_size=size,
        opening=_NO_OPENING,
        translation_std=float("inf"),
        rotation_std=float("inf"),
        points=_counts(0),
        residual=float("nan"),
        reason=reason,
    )


def _other_opening(fit: BinFit, cloud: GridCloud, rng: np.random.Generator) -> BinFit:
    """Return an unreliable fit with the opening of another size that the frame shows, if there is one."""
    anything = Prior(inner_size=None, T_cam_bin=None, extent=None)
    guess = None if fit.inner_size is None else guess_from_rim(cloud, anything, rng)
    if guess is None or fit.inner_size is None:
        return fit
    seen, stated = guess.state.opening, fit.inner_size[:2]
    if (seen[0] > seen[1]) != (stated[0] > stated[1]):
        seen = seen[::-1].copy()  # which side is the length cannot be seen
    if not is_another_size(seen, stated) or seen.max() > _LARGEST:
        return fit  # the bin may be elsewhere, but its size is right; or the unit is wrong by 1000
    return replace(fit, opening=seen, reason=f"{fit.reason}; {_other_size(seen, stated)}")


def _other_size(seen: Floats, stated: Floats) -> str:
    return f"an opening of about {size_in_mm(seen)} mm is seen, but inner_size says {size_in_mm(stated)} mm"


def _whole_opening(cloud: GridCloud, prior: Prior) -> Floats | None:
    """Return the (2,) length and width of the opening where the bin is believed to be [m]; None without a whole one.

    Edges of a bin of another size are missed where they are looked for, so that it may pass for one that is half seen.
    """
    if prior.T_cam_bin is None or prior.inner_size is None:
        return None
    guess = guess_from_rim(cloud, replace(prior, inner_size=None), np.random.default_rng(0))
    if guess is None or guess.outline < _WHOLE:
        return None
    seen, stated = guess.state.opening, prior.inner_size[:2]
    middle = (invert_transform(prior.T_cam_bin) @ guess.state.T_cam_bin)[:2, 3]
    there = np.all(np.abs(middle) <= stated / 2) and np.prod(seen) >= _LEAST_AREA * np.prod(stated)
    return seen if there else None


def _table(frame: Frame, cloud: GridCloud, rng: np.random.Generator) -> BinFit:
    """Return the fit of a table: the largest plane."""
    found = find_table(cloud, rng)
    if found is None:
        return _unknown(None, None, "no plane was found")
    plane, T_cam_table = found
    heights = plane.heights(cloud.points_cam)
    near = np.abs(heights) <= 3 * plane.noise
    return BinFit(
        T_world_bin=frame.T_world_cam @ T_cam_table,
        inner_size=None,
        opening=_NO_OPENING,
        translation_std=plane.noise,
        rotation_std=plane.noise / float(np.ptp(cloud.points_cam[near], axis=0).max()),
        points=_counts(int(np.count_nonzero(near))),
        residual=float(np.sqrt(np.mean(heights[near] ** 2))),
    )


def _counts(floor: int) -> dict[BinSurface, int]:
    """Return the number of points of each surface where only a floor was seen."""
    return {"floor": floor, "rim": 0, **dict.fromkeys(WALLS, 0)}
