"""Joint paths and their timing: from a curve in joint space to targets at the control rate.

Timing is TOPP-RA's (Pham and Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability
Analysis", IEEE T-RO 2018), in the package toppra: 3 ms for a path of 100 knots, exact limits, no stop between legs.
Ruckig times waypoints, not curves, and would leave a straight line. A trapezoid on the path's length has to obey the
worst curvature everywhere. TOPP-RA knows no limit of jerk; where one is set, :mod:`policies.motion.jerk` takes its
timing on.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from toppra import SplineInterpolator
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraintVarying

from binpick_env.config import CONTROL_PERIOD, RobotConfig
from perception.geometry import Floats, require_shape
from policies.motion.jerk import PathLimits, Progress, limit_jerk
from policies.motion.planning_scene import DOF

_KNOT_SPACING = 0.04  # distance between knots of smooth paths, Euclidean in joint space [rad]
_MIN_SPACING = 1e-6  # knots nearer to each other than this are merged [rad]
_BEND = 0.6  # magnitude of the slope at a leg's end that takes up its neighbour's direction; 1 along a chord
_RESERVE = 0.96  # share of the limits that is used; interpolation between knots may need the rest


@dataclass(frozen=True, eq=False, kw_only=True)
class JointPath:
    """A curve in joint space, untimed.

    Attributes:
        q: (W, 6) dense knots [rad]; a cubic spline through them is the curve.
        speed: (W,) share of the arm's velocity limit allowed at each knot.
        ends: Index of the knot at which each leg ends, in order; the last is W - 1.
    """

    q: Floats
    speed: Floats
    ends: tuple[int, ...]

    def __post_init__(self) -> None:
        require_shape("q", self.q, (None, DOF))
        require_shape("speed", self.speed, (len(self.q),))
        if len(self.q) == 0 or not np.all(np.isfinite(self.q)):
            raise ValueError("q must be finite and hold at least one knot")
        if not (np.all(self.speed > 0) and np.all(self.speed <= 1)):
            raise ValueError(f"speed must be in (0, 1], got {self.speed.min()} to {self.speed.max()}")


@dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory:
    """A timed joint path from rest to rest.

    Attributes:
        t: (T,) times from 0 at the control period [s].
        q: (T, 6) joint positions [rad]; the last row is the goal.
        qd: (T, 6) joint velocities [rad/s]; the first and the last row are zero.
        marks: Index of the sample at or just after the end of each leg of the path.
    """

    t: Floats
    q: Floats
    qd: Floats
    marks: tuple[int, ...]

    @property
    def duration(self) -> float:
        """Time from start to goal [s]."""
        return float(self.t[-1])


def leg(q: Floats, speed: float = 1.0) -> JointPath:
    """Return one leg through dense (W, 6) knots, on which ``speed`` is the allowed share of the velocity limit."""
    return JointPath(q=q, speed=np.full(len(q), float(speed)), ends=(len(q) - 1,))


def join(legs: Sequence[JointPath]) -> JointPath:
    """Chain legs, each of which begins where the one before it ends; where two speeds meet, the lower one holds."""
    if not legs:
        raise ValueError("legs must hold at least one path")
    q, speed, ends = legs[0].q, legs[0].speed, list(legs[0].ends)
    for following in legs[1:]:
        gap = float(np.max(np.abs(following.q[0] - q[-1])))
        if gap > 1e-3:
            raise ValueError(f"a leg must begin where the one before it ends, got a gap of {gap:.4f} rad")
        ends += [end + len(q) - 1 for end in following.ends]
        meet = min(speed[-1], following.speed[0])
        speed = np.concatenate([speed[:-1], [meet], following.speed[1:]])
        q = np.concatenate([q, following.q[1:]])
    return JointPath(q=q, speed=speed, ends=tuple(ends))


def smooth_path(waypoints: Floats, *, tangent_from: Floats | None = None, tangent_to: Floats | None = None) -> Floats:
    """Return dense (W, 6) knots of a cubic curve through waypoints; two without tangents give a straight line.

    Args:
        waypoints: (V, 6) postures to pass, start and goal included [rad].
        tangent_from: (6,) direction at the start, so that a leg before continues smoothly; the chord if None.
        tangent_to: (6,) direction at the goal, so that a leg behind continues smoothly; the chord if None.
    """
    require_shape("waypoints", waypoints, (None, DOF))
    chords = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    moves = np.concatenate([[True], chords > _MIN_SPACING])
    goal = waypoints[-1]
    waypoints, chords = waypoints[moves], chords[moves[1:]]
    if len(waypoints) < 2:
        return np.vstack([waypoints, goal]) if (goal != waypoints[0]).any() else waypoints
    s = np.concatenate([[0.0], np.cumsum(chords)])
    slopes = np.diff(waypoints, axis=0) / chords[:, None]
    inner = 0.5 * (slopes[:-1] + slopes[1:])
    first = slopes[0] if tangent_from is None else _BEND * _unit(tangent_from)
    last = slopes[-1] if tangent_to is None else _BEND * _unit(tangent_to)
    curve = CubicHermiteSpline(s, waypoints, np.vstack([first, inner, last]))
    counts = np.maximum(np.ceil(chords / _KNOT_SPACING).astype(int), 4)
    samples = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(s[:-1], s[1:], counts, strict=True)]
    knots: Floats = curve(np.concatenate([*samples, s[-1:]]))
    knots[0], knots[-1] = waypoints[0], goal
    return knots


def time_path(
    path: JointPath, limits: RobotConfig, *, scale: float = 1.0, period: float = CONTROL_PERIOD
) -> Trajectory | None:
    """Time a path as fast as the limits allow, then stretch it to a whole number of control periods.

    Args:
        path: Curve that is run from rest to rest.
        limits: Largest joint velocity, acceleration and, where it is limited, jerk.
        scale: Share of these limits to use, in (0, 1].
        period: Time between samples [s].

    Returns:
        The trajectory, or None if no timing obeys the limits.
    """
    if not 0 < scale <= 1:
        raise ValueError(f"scale must be in (0, 1], got {scale}")
    if not period > 0:
        raise ValueError(f"period must be positive, got {period}")
    q, speed, kept = _distinct_knots(path)
    if len(q) < 2:  # no motion, or one that is too small to be timed: one control period
        steps = int((path.q[0] != path.q[-1]).any())
        t, ends = period * np.arange(steps + 1, dtype=np.float64), path.q[[0, -1][-1 - steps :]]
        return Trajectory(t=t, q=ends, qd=np.zeros((steps + 1, DOF)), marks=(steps,) * len(path.ends))
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    acceleration = _RESERVE * scale * limits.max_acceleration
    curve = SplineInterpolator(s, q)
    grid = _with_middles(s, 0.5 * (s[:-1] + s[1:]))
    velocity = limits.max_velocity * _with_middles(speed, np.minimum(speed[:-1], speed[1:]))
    velocity = _RESERVE * scale * velocity
    rate = _path_rate(curve, grid, velocity, acceleration)
    if rate is None:
        return None
    if limits.max_jerk is not None:
        jerk = _RESERVE * scale * limits.max_jerk
        bounds = PathLimits(curve=curve.cspl, s=grid, velocity=velocity, acceleration=acceleration, jerk=jerk)
        return _with_limited_jerk(path, bounds, limit_jerk(bounds, rate), s[[kept[end] for end in path.ends]], period)
    arrival = np.concatenate([[0.0], np.cumsum(2 * np.diff(grid) / (rate[:-1] + rate[1:]))])
    steps = max(int(np.ceil(arrival[-1] / period - 1e-9)), 1)
    t = period * np.arange(steps + 1, dtype=np.float64)
    stretch = steps * period / arrival[-1]
    arrival, rate = arrival * stretch, rate / stretch
    at, speed_at = _progress(t, arrival, grid, rate)
    positions, velocities = curve(at), curve(at, 1) * speed_at[:, None]
    positions[[0, -1]], velocities[[0, -1]] = path.q[[0, -1]], 0.0
    marks = tuple(min(int(np.ceil(arrival[2 * kept[end]] / period - 1e-6)), steps) for end in path.ends)
    return Trajectory(t=t, q=positions, qd=velocities, marks=marks)


def _with_limited_jerk(
    path: JointPath, bounds: PathLimits, progress: Progress, ends: Floats, period: float
) -> Trajectory:
    """Sample a timing of a path that is stretched to a whole number of control periods.

    Args:
        path: The path.
        bounds: The curve through its knots.
        progress: Path length over time.
        ends: Path lengths at the ends of the legs [rad].
        period: Time between samples [s].
    """
    steps = max(int(np.ceil(progress.duration / period - 1e-9)), 1)
    t = period * np.arange(steps + 1, dtype=np.float64)
    slower = steps * period / progress.duration
    at, speed_at = progress(t / slower)[:2]
    at = np.clip(at, 0.0, bounds.s[-1])
    positions, velocities = bounds.curve(at), bounds.curve(at, 1) * speed_at[:, None] / slower
    positions[[0, -1]], velocities[[0, -1]] = path.q[[0, -1]], 0.0
    marks = tuple(min(int(mark), steps) for mark in np.searchsorted(at, ends - 1e-6))
    return Trajectory(t=t, q=positions, qd=velocities, marks=marks)


def _path_rate(curve: SplineInterpolator, s: Floats, velocity: Floats, acceleration: float) -> Floats | None:
    """Run TOPP-RA over a grid of G path lengths; return ds/dt there, (G,), or None where it finds none.

    Args:
        curve: Joint positions over the path length.
        s: (G,) path lengths of the grid [rad].
        velocity: (G,) velocity limit of every joint at each of them [rad/s].
        acceleration: Acceleration limit of every joint [rad/s^2].
    """
    both_ways = np.array([-1.0, 1.0])
    bounds = np.broadcast_to(velocity[:, None, None] * both_ways, (len(s), DOF, 2))

    def velocity_limit(at: float) -> Floats:
        bound: Floats = bounds[min(int(np.searchsorted(s, at - 1e-9)), len(s) - 1)]
        return bound

    constraints = [
        JointVelocityConstraintVarying(velocity_limit),
        JointAccelerationConstraint(np.tile(acceleration * both_ways, (DOF, 1))),
    ]
    solver = TOPPRA(constraints, curve, gridpoints=s, solver_wrapper="seidel")
    _, rate, _ = solver.compute_parameterization(0.0, 0.0)
    if rate is None or not np.all(np.isfinite(rate)) or np.any(rate[:-1] + rate[1:] <= 0):
        return None
    found: Floats = rate
    return found


def _with_middles(knots: Floats, middles: Floats) -> Floats:
    """Interleave (W,) values at the knots with (W - 1,) between them, where TOPP-RA then checks the spline as well."""
    grid = np.empty(len(knots) + len(middles))
    grid[::2], grid[1::2] = knots, middles
    return grid


def _progress(t: Floats, arrival: Floats, s: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """Return the (T,) path length and its rate at (T,) times, uniformly accelerated between (G,) grid points."""
    knot = np.clip(np.searchsorted(arrival, t, side="right") - 1, 0, len(s) - 2)
    since = t - arrival[knot]
    push = (rate[knot + 1] ** 2 - rate[knot] ** 2) / (2 * (s[knot + 1] - s[knot]))
    return s[knot] + since * rate[knot] + 0.5 * push * since**2, rate[knot] + push * since


def _distinct_knots(path: JointPath) -> tuple[Floats, Floats, list[int]]:
    """Drop knots that repeat the one before; return knots, speeds, and the new index of each old knot."""
    moves = np.concatenate([[True], np.linalg.norm(np.diff(path.q, axis=0), axis=1) > _MIN_SPACING])
    return path.q[moves], path.speed[moves], (np.cumsum(moves) - 1).tolist()


def _unit(vector: Floats) -> Floats:
    length = float(np.linalg.norm(vector))
    if not length > 0:
        raise ValueError("a tangent must have a length")
    return vector / length
