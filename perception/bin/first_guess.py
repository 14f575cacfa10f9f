"""First guesses of a bin's pose: from the plane of its rim and the hole in it, or from its floor alone."""

from dataclasses import dataclass

import numpy as np

from perception.bin.cloud import GridCloud, Plane
from perception.bin.opening import Opening, find_openings
from perception.bin.planes import TOLERANCE, find_plane, peaks
from perception.bin.refinement import BinState
from perception.geometry import Floats, invert_transform, make_transform, transform_points

FARTHEST, STEEPEST = 0.15, np.deg2rad(15.0)  # how far off the pose that a search starts from may be [m and rad]
_TILT = np.deg2rad(70.0)  # largest angle between the optical axis and the bin's, where nothing else is known [rad]
_SLAB = 0.06  # height above and below the stated rim in which it is looked for [m]
_LEVEL, _LEVEL_SHARE, _LEVELS = 0.002, 0.01, 8  # width of a level [m], its least share of the points, number of levels
_PARALLEL = np.deg2rad(3.0)  # largest angle between a rim and a floor or a table [rad]
_RIM_SHARE = 0.5  # least share of an opening's outline beside which its rim is measured
_MISFIT, _MISFIT_SHARE = 0.025, 0.15  # largest difference of an opening and the stated size, in metres and as a share
_FLOOR_SLAB = 0.05  # height above and below the stated floor in which it is looked for, without a rim [m]
_FLOOR_CELL = 0.01  # side of the cells whose lowest points it is looked for in [m]
_FLOOR_SHARE, _BELOW_SHARE = 0.2, 0.03  # least share of the cells on a floor, and largest share below it
_BAND, _AROUND_SHARE = 0.04, 0.7  # width of the band around a table's region [m], and least share of the table in it


@dataclass(frozen=True, eq=False, kw_only=True)
class Prior:
    """What is known of a bin before it is looked for.

    Attributes:
        inner_size: (3,) inner length, width and height [m]; None if unknown.
        T_cam_bin: (4, 4) pose that it is believed to have; None if unknown.
        extent: (2,) length and width of the region around that pose in which it lies [m]; None if unknown.
        height_known: Whether the height of ``inner_size`` is about right, so that it tells where the rim is.
    """

    inner_size: Floats | None
    T_cam_bin: Floats | None
    extent: Floats | None
    height_known: bool = True

    def region(self, points_cam: Floats) -> Floats:
        """Return those of (N, 3) points that lie over or under the region of the bin, a little wider than it."""
        if self.T_cam_bin is None or self.extent is None:
            return points_cam
        points_bin = transform_points(invert_transform(self.T_cam_bin), points_cam)
        along, across = self.extent / 2 + FARTHEST
        near = (np.abs(points_bin[:, 0]) <= along) & (np.abs(points_bin[:, 1]) <= across)
        inside: Floats = points_cam[near]
        return inside


@dataclass(frozen=True, eq=False, kw_only=True)
class FirstGuess:
    """A first guess of a bin's pose.

    Attributes:
        state: The bin.
        rim: Whether its rim was found; otherwise only its floor was.
        whole: Whether the opening was found as a whole, so that its edges are near.
        outline: Share of the outline of that opening beside which its rim was measured, in [0, 1].
    """

    state: BinState
    rim: bool
    whole: bool
    outline: float = 0.0


def guess_from_rim(cloud: GridCloud, prior: Prior, rng: np.random.Generator) -> FirstGuess | None:
    """Return a guess from the plane of the rim; None if no plane can be it.

    Args:
        cloud: Points of the frame.
        prior: What is known of the bin.
        rng: Source of random samples.
    """
    x_cam = np.array([1.0, 0.0, 0.0]) if prior.T_cam_bin is None else prior.T_cam_bin[:3, 0]
    planes = _rim_planes(cloud, prior, rng)
    found: list[tuple[float, Opening, Plane]] = []
    for plane in planes:
        for opening in find_openings(cloud, plane, x_cam):
            turned = _as_stated(opening, prior)
            if turned is not None:
                found.append((_merit(turned, prior), turned, plane))
    if found:
        _, opening, plane = max(found, key=lambda each: each[0])
        state = _state_of_opening(opening, plane, cloud, prior)
        return FirstGuess(state=state, rim=True, whole=True, outline=opening.rim)
    if prior.T_cam_bin is None or prior.inner_size is None or not prior.height_known or not planes:
        return None
    plane = planes[0]
    T_cam_bin = _upright(prior.T_cam_bin, plane, prior.inner_size[2])
    state = BinState(T_cam_bin=T_cam_bin, size=prior.inner_size, noise=plane.noise)
    return FirstGuess(state=state, rim=True, whole=False)


def guess_from_floor(cloud: GridCloud, prior: Prior, rng: np.random.Generator) -> FirstGuess | None:
    """Return a guess from the floor of a bin without walls, such as a table; None if it is hidden or has a border.

    Args:
        cloud: Points of the frame.
        prior: What is known of the bin.
        rng: Source of random samples.
    """
    if prior.T_cam_bin is None or prior.inner_size is None:
        return None
    points_bin = transform_points(invert_transform(prior.T_cam_bin), cloud.points_cam)
    half = prior.inner_size[:2] / 2
    over = np.all(np.abs(points_bin[:, :2]) <= half, axis=1)
    cells = np.floor((points_bin[over, :2] + half) / _FLOOR_CELL).astype(np.int64)
    index = cells[:, 0] * (int(cells[:, 1].max(initial=0)) + 1) + cells[:, 1]
    order = np.lexsort((points_bin[over, 2], index))
    lowest = order[np.flatnonzero(np.diff(index[order], prepend=-1))]
    points_cam, heights = cloud.points_cam[over][lowest], points_bin[over, 2][lowest]
    near = np.abs(heights) <= _FLOOR_SLAB
    plane = find_plane(points_cam[near], prior.T_cam_bin[:3, 2], STEEPEST, rng)
    if plane is None:
        return None
    above = plane.heights(points_cam)
    on = np.abs(above) <= max(TOLERANCE, 3 * plane.noise)
    wide = _extent(points_bin[over][lowest][on])
    lower = np.count_nonzero(above < -max(2 * TOLERANCE, 4 * plane.noise))
    if np.mean(on) < _FLOOR_SHARE or lower > _BELOW_SHARE * len(above) or np.any(wide < half):
        return None
    beside = (~over) & np.all(np.abs(points_bin[:, :2]) <= half + _BAND, axis=1)
    around = np.abs(plane.heights(cloud.points_cam[beside])) <= 2 * TOLERANCE
    if len(around) == 0 or np.mean(around) < _AROUND_SHARE:
        return None  # walls or whatever else is around it: it is no table, but its rim was not found
    T_cam_bin = _upright(prior.T_cam_bin, plane, 0.0)
    return FirstGuess(
        state=BinState(T_cam_bin=T_cam_bin, size=prior.inner_size, noise=plane.noise), rim=False, whole=False
    )


def find_table(cloud: GridCloud, rng: np.random.Generator) -> tuple[Plane, Floats] | None:
    """Return the largest plane and the pose of a table there; None without any plane.

    The origin of the (4, 4) pose lies on the optical axis, z points up, and x to the right in the image.
    """
    plane = find_plane(cloud.points_cam, np.array([0.0, 0.0, -1.0]), _TILT, rng)
    if plane is None:
        return None
    T = _upright(make_transform(np.diag([1.0, -1.0, -1.0])), plane, 0.0)
    T[:3, 3] = plane.meet(np.array([[0.0, 0.0, 1.0]]))[0]
    return plane, T


def _extent(points_bin: Floats) -> Floats:
    return np.ptp(points_bin[:, :2], axis=0) if len(points_bin) else np.zeros(2)


def _rim_planes(cloud: GridCloud, prior: Prior, rng: np.random.Generator) -> list[Plane]:
    """Return planes that may be the rim's, the likeliest first."""
    points = prior.region(cloud.points_cam)
    if prior.T_cam_bin is not None and prior.inner_size is not None and prior.height_known:
        heights = transform_points(invert_transform(prior.T_cam_bin), points)[:, 2] - prior.inner_size[2]
        points = points[np.abs(heights) <= min(_SLAB, 0.7 * prior.inner_size[2])]
        first = find_plane(points, prior.T_cam_bin[:3, 2], STEEPEST, rng)
        if first is None:
            return []
        others = points[np.abs(first.heights(points)) > 2 * TOLERANCE]
        second = find_plane(others, prior.T_cam_bin[:3, 2], STEEPEST, rng)
        return [first] if second is None else [first, second]
    up, tilt = (np.array([0.0, 0.0, -1.0]), _TILT) if prior.T_cam_bin is None else (prior.T_cam_bin[:3, 2], STEEPEST)
    base = find_plane(points, up, tilt, rng)
    if base is None:
        return []
    levels = peaks(base.heights(points), _LEVEL, _LEVEL_SHARE)[:_LEVELS]
    heights = base.heights(points)
    slabs = [points[np.abs(heights - level) <= 2 * TOLERANCE] for level in levels]
    fitted = [find_plane(slab, base.normal, _PARALLEL, rng) for slab in slabs]
    return [plane for plane in fitted if plane is not None]


def _as_stated(opening: Opening, prior: Prior) -> Opening | None:
    """Return an opening, its sides exchanged if it then fits; None if it is not the bin that is looked for."""
    if opening.rim < _RIM_SHARE:
        return None
    if prior.T_cam_bin is not None:
        away = np.linalg.norm(opening.T_cam_opening[:2, 3] - _over(prior, opening)[:2])
        return opening if away <= FARTHEST and _fits(opening, prior) else None
    if _fits(opening, prior):
        return opening
    quarter = make_transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned = Opening(T_cam_opening=opening.T_cam_opening @ quarter, size=opening.size[::-1].copy(), rim=opening.rim)
    return turned if _fits(turned, prior) else None


def _over(prior: Prior, opening: Opening) -> Floats:
    """Return the (3,) point above the believed middle of the floor that is as high as an opening, camera frame."""
    assert prior.T_cam_bin is not None
    up, floor = prior.T_cam_bin[:3, 2], prior.T_cam_bin[:3, 3]
    point: Floats = floor + ((opening.T_cam_opening[:3, 3] - floor) @ up) * up
    return point


def _fits(opening: Opening, prior: Prior) -> bool:
    """Return whether an opening is about as large as the bin's should be."""
    if prior.inner_size is None:
        return True
    stated = prior.inner_size[:2]
    return bool(np.all(np.abs(opening.size - stated) <= np.maximum(_MISFIT, _MISFIT_SHARE * stated)))


def _merit(opening: Opening, prior: Prior) -> float:
    """Return how good an opening is: the best is that of the likeliest bin."""
    if prior.inner_size is None:
        return float(opening.rim * np.prod(opening.size))
    misfit = float(np.abs(opening.size - prior.inner_size[:2]).max())
    away = (
        0.0 if prior.T_cam_bin is None else float(np.linalg.norm(opening.T_cam_opening[:3, 3] - _over(prior, opening)))
    )
    return opening.rim - misfit / _MISFIT - away / FARTHEST


def _state_of_opening(opening: Opening, plane: Plane, cloud: GridCloud, prior: Prior) -> BinState:
    """Return the bin below an opening, whose height is measured if it is not stated."""
    if prior.inner_size is not None:
        size = prior.inner_size
    else:
        size = np.array([*opening.size, _depth_below(opening, cloud)])
    T_cam_bin = opening.T_cam_opening @ make_transform(translation=(0.0, 0.0, -size[2]))
    return BinState(T_cam_bin=T_cam_bin, size=size, noise=plane.noise, free=prior.inner_size is None)


def _depth_below(opening: Opening, cloud: GridCloud) -> float:
    """Return the depth of the lowest level below an opening [m], or of the lowest point if there is no level."""
    points = transform_points(invert_transform(opening.T_cam_opening), cloud.points_cam)
    inside = np.all(np.abs(points[:, :2]) <= opening.size / 2 - 0.01, axis=1)
    depths = -points[inside, 2]
    depths = depths[depths > 0.01]
    levels = peaks(depths, _LEVEL, 0.005)
    return float(levels.max()) if len(levels) else float(depths.max(initial=0.01))


def _upright(T_cam_bin: Floats, plane: Plane, height: float) -> Floats:
    """Return a bin's pose turned and lifted so that a plane lies ``height`` [m] above its floor and parallel to it."""
    z = plane.normal
    x = T_cam_bin[:3, 0] - (T_cam_bin[:3, 0] @ z) * z
    x = x / np.linalg.norm(x)
    rotation = np.column_stack([x, np.cross(z, x), z])
    over = T_cam_bin[:3, 3] + height * T_cam_bin[:3, 2]
    origin = over - plane.heights(over[None])[0] * z - height * z
    return make_transform(rotation, origin)
