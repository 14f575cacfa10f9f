"""Joint refinement of a bin's pose on all its surfaces: Gauss-Newton, point to plane, with Tukey's weights."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from perception.bin.bin_fit import BinSurface
from perception.bin.cloud import GridCloud
from perception.bin.edges import SIDES, RimEdges
from perception.bin.planes import LEAST_NOISE, peaks
from perception.geometry import Floats, invert_transform, make_transform, transform_points

WALLS: tuple[BinSurface, ...] = ("wall_x+", "wall_x-", "wall_y+", "wall_y-")  # in the order of `SIDES`
GATE = 0.003  # distance from a surface up to which points may belong to it [m]
_ASIDE = 0.003  # distance from walls within which no floor is looked for, and from edges of no rim [m]
_RIM_WIDTH = 0.06  # largest width of a rim [m]
_MOST = 1500  # number of points of a surface that are used
_ITERATIONS = 6
_TUKEY = 4.685  # cut-off of Tukey's biweight in standard deviations, for 95 % efficiency
_HUBER = 0.0005  # distance of an edge's points from which their influence grows no further [m]
_HEIGHT_STD = 0.001  # standard deviation of the stated height of the rim above the floor [m]
_INSET_STD = 0.0005  # the same of an opening's half length beyond the stated one, with one side seen [m]
_FREE_STD = 0.02  # the same where it is measured [m]
_CORRELATED = 0.0001  # error of a surface's mean distance that more points do not reduce [m]
_FEWEST_ON_FACE = 30  # number of points near the inner face of a wall from which it counts as seen
_FLOOR_CELL = 0.01  # side of the cells whose lowest points the floor is looked for in [m]
_FEWEST_CELLS = 15  # number of cells in which a floor is seen
_FLOOR_RANGE = 0.015  # largest difference of the measured and the stated height of the rim above the floor [m]


@dataclass(frozen=True, eq=False, kw_only=True)
class BinState:
    """A bin during the refinement.

    Attributes:
        T_cam_bin: (4, 4) pose of the bin.
        size: (3,) inner length, width and height [m].
        inset: (2,) half of what the measured opening exceeds length and width by [m].
        lift: What the measured height of the rim above the floor exceeds the height by [m].
        noise: Standard deviation of the depth measurements [m].
        free: Whether the size is to be measured; otherwise it is nearly right.
    """

    T_cam_bin: Floats
    size: Floats
    inset: Floats = field(default_factory=lambda: np.zeros(2))
    lift: float = 0.0
    noise: float = 0.0005
    free: bool = False

    @property
    def opening(self) -> Floats:
        """(2,) length and width of the opening between the inner edges of the rim [m]."""
        opening: Floats = self.size[:2] + 2 * self.inset
        return opening


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfacePoints:
    """Points and the surfaces that they were measured on.

    Attributes:
        points_cam: (N, 3) points in the camera frame [m].
        normals_bin: (N, 3) outward unit normals of their surfaces, bin frame.
        kinds: (N,) kind of each point's surface: `FLOOR`, `RIM`, `EDGE` and `FACE` plus the index of a side in `SIDES`.
        floor: Height at which the floor was seen, bin frame [m]; None if it was not seen.
    """

    points_cam: Floats
    normals_bin: Floats
    kinds: NDArray[np.int64]
    floor: float | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Refined:
    """A refined bin.

    Attributes:
        state: The bin.
        points: Number of points that support each surface.
        residual: Root mean square distance of these points [m]; NaN without any.
        covariance: (6, 6) covariance of the bin's translation [m] and rotation [rad] in its own frame.
    """

    state: BinState
    points: dict[BinSurface, int]
    residual: float
    covariance: Floats


FLOOR, RIM, EDGE, FACE = 0, 1, 2, 6  # first kinds: floor, rim, four edges of the rim, four inner faces


def collect_points(cloud: GridCloud, state: BinState, edges: RimEdges | None, *, faces: bool) -> SurfacePoints:
    """Return the points near the surfaces of a bin.

    Args:
        cloud: Points of the frame.
        state: The bin as it is known so far.
        edges: Points on the inner edges of its rim; None if the rim was not found.
        faces: Whether to take points near the inner faces of the walls, too: once the bin is known to millimetres.
    """
    p = transform_points(invert_transform(state.T_cam_bin), cloud.points_cam)
    gate = max(GATE, 3 * state.noise)
    x, y, z = np.abs(p[:, 0]), np.abs(p[:, 1]), p[:, 2].copy()
    length, width, height = state.size / (2, 2, 1)
    beside = (x - length, y - width)
    found: list[tuple[int, Floats, tuple[float, float, float]]] = []
    inside = (beside[0] < -_ASIDE) & (beside[1] < -_ASIDE)
    floor = floor_height(p[inside], state)
    if floor is not None:
        found.append((FLOOR, cloud.points_cam[inside & (np.abs(z - floor) <= gate)], (0, 0, 1)))
    if edges is not None:
        beyond = np.maximum(x - state.opening[0] / 2, y - state.opening[1] / 2)
        on_rim = (beyond > _ASIDE) & (beyond < _RIM_WIDTH) & (np.abs(z - height - state.lift) <= gate)
        found.append((RIM, cloud.points_cam[on_rim], (0, 0, 1)))
    between = (z > 2 * gate) & (z < height - 2 * gate)
    for k, (axis, sign) in enumerate(SIDES):
        normal = tuple(float(sign) if j == axis else 0.0 for j in range(3))
        if edges is not None:
            found.append((EDGE + k, edges.points_cam[edges.sides == k], normal))  # type: ignore[arg-type]
        aside = max(GATE, 3 * state.noise * _slant(state, axis, sign))
        near = between & (np.abs(beside[axis]) <= aside) & (sign * p[:, axis] > 0) & (beside[1 - axis] < -2 * gate)
        if faces and np.count_nonzero(near) >= _FEWEST_ON_FACE:
            found.append((FACE + k, cloud.points_cam[near], normal))  # type: ignore[arg-type]
    found = [(kind, points[:: max(len(points) // _MOST, 1)], normal) for kind, points, normal in found]
    return SurfacePoints(
        points_cam=np.concatenate([points for _, points, _ in found] or [np.zeros((0, 3))]),
        normals_bin=np.concatenate(
            [np.tile(normal, (len(points), 1)) for _, points, normal in found] or [np.zeros((0, 3))]
        ),
        kinds=np.concatenate([np.full(len(points), kind) for kind, points, _ in found] or [np.zeros(0, np.int64)]),
        floor=floor,
    )


def lowered(state: BinState, floor: float | None) -> BinState:
    """Return a bin moved down to its floor, if that is lower than stated, with the rim where it was.

    From the stated height the refinement would take the points of such a floor for outliers. A floor that seems higher
    may be flat parts, and moves nothing.

    Args:
        state: The bin.
        floor: Height at which its floor was seen, bin frame [m]; None if it was not seen.
    """
    if floor is None or floor >= 0:
        return state
    T_cam_bin = state.T_cam_bin @ make_transform(translation=(0.0, 0.0, floor))
    return replace(state, T_cam_bin=T_cam_bin, lift=state.lift - floor)


def _slant(state: BinState, axis: int, sign: int) -> float:
    """Return how far the inner face of a wall seems to move along its normal where the depth is 1 too large or small.

    A wall that is seen from above hardly moves, so that points farther off are those of parts beside it.

    Args:
        state: The bin as it is known so far.
        axis: Axis of the wall's normal.
        sign: Sign of the normal.
    """
    face = np.array([0.0, 0.0, state.size[2] / 2])
    face[axis] = sign * state.size[axis] / 2
    ray = face - invert_transform(state.T_cam_bin)[:3, 3]
    return float(abs(ray[axis]) / np.linalg.norm(ray))


def floor_height(points_bin: Floats, state: BinState) -> float | None:
    """Return the height of the floor near the stated one [m], from the lowest points of cells; None if it is not seen.

    Nothing is measured below a floor, so that it is the lowest height at which many cells have their lowest points.
    Flat parts that cover all of it are higher than the stated floor: those are no floor.

    Args:
        points_bin: (N, 3) points between the walls, bin frame [m].
        state: The bin as it is known so far.
    """
    cells = np.floor((points_bin[:, :2] + state.size[:2] / 2) / _FLOOR_CELL).astype(np.int64)
    across = int(np.ceil(state.size[1] / _FLOOR_CELL)) + 1
    index = cells[:, 0] * across + cells[:, 1]
    lowest = np.full(int(index.max(initial=0)) + 1, np.inf)
    np.minimum.at(lowest, index, points_bin[:, 2])
    lowest = lowest[np.isfinite(lowest)] + 2 * state.noise  # the least of some ten measurements lies about this low
    near = lowest[np.abs(lowest) <= _FLOOR_RANGE]
    below = np.count_nonzero(lowest < -_FLOOR_RANGE)
    if len(near) < _FEWEST_CELLS or below > 0.5 * len(lowest):
        return None
    width = max(0.001, state.noise)
    found = peaks(near, width, _FEWEST_CELLS / len(near))
    found = found[found <= max(GATE, 3 * state.noise)]
    return float(found.min()) if len(found) else None


def refine(state: BinState, on: SurfacePoints, fixed: Floats) -> Refined:
    """Return the bin whose surfaces fit the points best.

    Args:
        state: The bin to start from.
        on: Points near its surfaces.
        fixed: (6,) standard deviations of the prior of the pose's translation [m] and rotation [rad] in the bin frame:
            small for what the points cannot tell, infinite elsewhere.
    """
    counts = np.bincount(on.kinds, minlength=FACE + 4)
    both = np.array([all(counts[EDGE + 2 * axis : EDGE + 2 * axis + 2] > 0) for axis in (0, 1)])
    spread = np.where(both, _FREE_STD, _FREE_STD if state.free else _INSET_STD)
    height_std = _FREE_STD if state.free else _HEIGHT_STD
    start = state.T_cam_bin
    priors = np.array([*(1 / fixed**2), height_std**-2, *spread**-2.0])
    # A surface's points share an error, so that many of them count little more than a few.
    sigma = max(state.noise, LEAST_NOISE)
    worth = 1 / np.sqrt(1 + counts * (_CORRELATED / sigma) ** 2)
    values = np.array([*np.zeros(6), state.lift, *state.inset])
    straight = (on.kinds >= EDGE) & (on.kinds < FACE)
    weights = np.zeros(len(on.kinds))
    residuals = np.zeros(len(on.kinds))
    information = np.diag(priors)
    for _ in range(_ITERATIONS):
        T_cam_bin = start @ _exponential(values[:6])
        p = transform_points(invert_transform(T_cam_bin), on.points_cam)
        residuals = np.einsum("ij,ij->i", p, on.normals_bin) - _targets(state.size, values, on.kinds)
        weights = _robust_weights(residuals, sigma, straight) * (worth[on.kinds] / sigma) ** 2
        # p changes by -(t + w x p) when the bin moves by t and turns by w in its own frame.
        J = np.zeros((len(p), 9))
        J[:, :3] = -on.normals_bin
        J[:, 3:6] = -np.cross(p, on.normals_bin)
        J[on.kinds == RIM, 6] = -1
        J[straight & (on.kinds < EDGE + 2), 7] = -1
        J[straight & (on.kinds >= EDGE + 2), 8] = -1
        information = J.T @ (J * weights[:, None]) + np.diag(priors)
        gradient = J.T @ (weights * residuals) + priors * values
        change = -np.linalg.solve(information, gradient)
        values = values + change
        if np.abs(change).max() < 1e-7:
            break
    moved = start @ _exponential(values[:6])
    supporting = weights > 0
    support = np.bincount(on.kinds[supporting], minlength=FACE + 4)
    points: dict[BinSurface, int] = {"floor": int(support[FLOOR]), "rim": int(support[RIM])}
    points |= {name: int(support[EDGE + k] + support[FACE + k]) for k, name in enumerate(WALLS)}
    return Refined(
        state=replace(state, T_cam_bin=moved, lift=float(values[6]), inset=values[7:]),
        points=points,
        residual=float(np.sqrt(np.mean(residuals[supporting] ** 2))) if supporting.any() else float("nan"),
        covariance=np.linalg.inv(information)[:6, :6],
    )


def _robust_weights(residuals: Floats, sigma: float, straight: NDArray[np.bool_]) -> Floats:
    """Return the (N,) weights of residuals: Tukey's, and Huber's for points that were chosen as a straight line."""
    scale = max(sigma, GATE / _TUKEY / 2)
    tukey = np.clip(1 - (residuals / (_TUKEY * scale)) ** 2, 0, None) ** 2
    return np.where(straight, 1 / np.maximum(np.abs(residuals) / _HUBER, 1), tukey)


def _targets(size: Floats, values: Floats, kinds: NDArray[np.int64]) -> Floats:
    """Return the (N,) distances of the points' surfaces from the bin's origin along their normals [m]."""
    length, width = size[:2] / 2
    edges = [length + values[7], length + values[7], width + values[8], width + values[8]]
    table = np.array([0.0, size[2] + values[6], *edges, length, length, width, width])
    targets: Floats = table[kinds]
    return targets


def _exponential(twist: Floats) -> Floats:
    """Return the (4, 4) transform of a translation [m] and a rotation vector [rad]."""
    return make_transform(Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3])
