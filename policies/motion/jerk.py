"""Timing of a path within a limit of jerk: the path stays as it is, only the speed along it changes.

With s the path's length, b = (ds/dt)^2 as a function of s turns velocity and acceleration into linear terms of b and
its derivative b' (Verscheure et al., "Time-Optimal Path Tracking for Robots: A Convex Optimization Approach", IEEE TAC
2009), and a joint's jerk into

    sqrt(b) (q''' b + 3/2 q'' b' + 1/2 q' b'').

A bound J on it is not convex. Written as ``|q''' b + ...| <= J / sqrt(b)``, its right side is convex and lies above its
tangent at the last iteration's b; with the tangent in its place the bound is linear and on the safe side. So a few
linear programs in b on a grid, from TOPP-RA's timing on, approach a timing that is limited in jerk: the sequence of
Debrouwere et al., "Time-Optimal Path Following for Robots With Convex-Concave Constraints Using Sequential Convex
Programming", IEEE T-RO 2013. At rest, where b goes as s^(4/3), a constant jerk bounds it instead.

Between grid points the bounds may be passed. The rate is therefore interpolated over time by a cubic spline, s is
smoothed by a moving average over time, velocity, acceleration and jerk of every joint are computed from the spline's
derivatives on a fine grid of times, the acceleration and jerk allowed where they are passed are lowered for the next
program, and time is stretched as little as is needed in the end. The limits thus hold whatever the programs gave.

To smooth TOPP-RA's timing by a moving average and to stretch it as a whole is simpler, but lets the sharpest bend slow
the whole path: over 14 transfers it takes 1.9, 2.4 and 3.0 times the time without a limit at 100, 50 and 25 rad/s^3, or
1.4, 1.7 and 2.2 times if each place also has a speed limit of its own from the third derivative there. The programs
take 1.27, 1.50 and 1.88 times. The smoothed timing remains among those that are compared, and is the fastest where the
limit hardly matters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.interpolate import CubicSpline, PPoly
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, diags, vstack

from perception.geometry import Floats

_PROGRAMS = 4  # number of linear programs
_CORRECTION = 0.7  # power of the ratio of limit and value by which the limit of the next program is lowered
_LEAST_SHARE = 0.2  # smallest share of a limit to which it is lowered
_WIDTHS = (0.001, 0.015, 0.03, 0.045, 0.06, 0.09)  # widths of the moving average that are tried [s]
_CHECK_PERIOD = 0.004  # time between two samples at which timings are compared [s]
_FINE_PERIOD = 0.0005  # time between two samples at which the chosen timing is checked [s]
_INTERVALS = 40  # least number of intervals of the grid
_FROM_REST = 4  # number of grid points at each end whose rate is that of a constant jerk at most
_LEAST = 1e-6  # smallest squared rate between the ends [rad^2/s^2]


@dataclass(frozen=True, eq=False, kw_only=True)
class PathLimits:
    """What a timing of a path must obey.

    Attributes:
        curve: (6,) joint positions over the path's length [rad].
        s: (G,) rising path lengths, from 0 [rad].
        velocity: (G,) velocity limit of every joint, each up to its path length from the one before [rad/s].
        acceleration: Acceleration limit of every joint [rad/s^2].
        jerk: Jerk limit of every joint [rad/s^3].
    """

    curve: CubicSpline
    s: Floats
    velocity: Floats
    acceleration: float
    jerk: float

    def velocity_at(self, s: Floats) -> Floats:
        """Return the velocity limit at (T,) path lengths."""
        found: Floats = self.velocity[np.minimum(np.searchsorted(self.s, s - 1e-9), len(self.s) - 1)]
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class Progress:
    """Path length over time, at rest before 0 and after the duration.

    Attributes:
        integral: Integral over time of the path length before it is smoothed.
        rest: Time at which that path length comes to its end [s].
        width: Width of the moving average [s].
        stretch: Factor of time.
    """

    integral: PPoly
    rest: float
    width: float
    stretch: float = 1.0

    @property
    def duration(self) -> float:
        """Time from start to goal [s]."""
        return (self.rest + self.width) * self.stretch

    def __call__(self, t: Floats) -> Floats:
        """Return the (4, T) path length and its first three derivatives at (T,) times."""
        now = np.asarray(t) / self.stretch
        rows = [(self._before(now, n) - self._before(now - self.width, n)) / self.width for n in range(4)]
        return np.stack([row / self.stretch**n for n, row in enumerate(rows)])

    def _before(self, t: Floats, order: int) -> Floats:
        """Return a derivative of the integral, which is constant before 0 and straight after the end."""
        inside: Floats = self.integral(np.clip(t, 0.0, self.rest), order)
        if order == 0:
            after = np.maximum(t - self.rest, 0.0)
            return inside + after * float(self.integral(self.rest, 1))
        at_rest = (t < 0) | (t > self.rest)
        return np.where(at_rest, self.integral(np.where(t > 0, self.rest, 0.0), order) if order == 1 else 0.0, inside)


def limit_jerk(limits: PathLimits, rate: Floats) -> Progress:
    """Return a timing that obeys limits of velocity, acceleration and jerk, from one that need not obey the last.

    Args:
        limits: Path and limits.
        rate: (G,) path length per time at ``limits.s`` [rad/s]; 0 at both ends only.

    Note:
        About 0.1 s for a path of 70 knots.
    """
    s = _refined(limits.s)
    squared = np.interp(s, limits.s, rate**2)
    best = _fastest(limits, [_with_steps(s, squared)])
    programs = _Programs(limits, s)
    allowed = np.tile([[limits.acceleration], [limits.jerk]], len(s))
    for _ in range(_PROGRAMS):
        found = programs.solve(squared, allowed)
        if found is None:
            break
        squared = found
        progress = _fastest(limits, [_smooth(s, squared)])
        best = min(best, progress, key=lambda each: each.duration)
        allowed = _lowered(limits, s, progress, allowed)
    best = min(best, _fastest(limits, [_with_steps(s, squared)]), key=lambda each: each.duration)
    return _stretched(limits, best, _FINE_PERIOD)


class _Programs:
    """The linear programs of one path: bounds on its squared rate b at G path lengths."""

    def __init__(self, limits: PathLimits, s: Floats) -> None:
        self._s, self._count = s, len(s)
        before, after = np.diff(s)[:-1], np.diff(s)[1:]
        inner = np.arange(1, self._count - 1)
        places = (np.tile(inner - 1, 3), np.concatenate([inner - 1, inner, inner + 1]))
        shape = (self._count - 2, self._count)

        def stencil(*columns: Floats) -> csr_matrix:
            return csr_matrix((np.concatenate(columns), places), shape=shape)

        span, zero = before + after, np.zeros(len(before))
        value = stencil(zero, zero + 1.0, zero)
        slope = stencil(-after / (before * span), (after - before) / (before * after), before / (after * span))
        bend = stencil(2 / (before * span), -2 / (before * after), 2 / (after * span))
        slopes = stencil(-1 / before, 1 / before, zero), stencil(zero, -1 / after, 1 / after)  # backward and forward
        first, second, third = (limits.curve(s, n)[1:-1] for n in (1, 2, 3))
        third = _larger(limits.curve(s - 1e-9, 3)[1:-1], third)  # constant between knots
        joints = range(first.shape[1])
        acceleration = [diags(second[:, j]) @ value + diags(first[:, j] / 2) @ each for each in slopes for j in joints]
        jerk = [
            diags(third[:, j]) @ value + diags(1.5 * second[:, j]) @ slope + diags(first[:, j] / 2) @ bend
            for j in joints
        ]
        pushes, jerks = vstack(acceleration), vstack(jerk)
        self._rows = vstack([pushes, -pushes, jerks, -jerks], format="csr")
        self._values = vstack([0 * pushes, 0 * pushes] + [value] * (2 * len(joints)), format="csr")
        self._pushes, self._repeats = 2 * pushes.shape[0], 2 * len(joints)
        self._steepest = np.abs(limits.curve(s, 1)).max(axis=1)
        velocity = np.minimum(limits.velocity_at(s), limits.velocity_at(s + 2e-9))
        self._top = (velocity / self._steepest) ** 2
        self._weights = (before + after) / 2

    def solve(self, around: Floats, allowed: Floats) -> Floats | None:
        """Return the (G,) squared rates of least time, with all bounds taken linearly; None if the solver fails.

        Args:
            around: (G,) squared rates at which times and bounds are taken linearly.
            allowed: (2, G) limits of every joint's acceleration [rad/s^2] and jerk [rad/s^3] at each path length.
        """
        around = np.maximum(around[1:-1], 10 * _LEAST)
        acceleration, jerk = allowed[:, 1:-1]
        # J / sqrt(b) lies above its tangent J / sqrt(b0) (3/2 - b / (2 b0)).
        tangent = np.concatenate([np.zeros(self._pushes), np.tile(jerk / (2 * around**1.5), self._repeats)])
        rows = self._rows + diags(tangent) @ self._values
        pushes, jerks = np.tile(acceleration, 2 * self._repeats), np.tile(1.5 * jerk / np.sqrt(around), self._repeats)
        bounds = np.concatenate([pushes, jerks])
        size = 1 / np.maximum(np.abs(rows).max(axis=1).toarray().ravel(), 1e-9)
        gain = self._weights / around**1.5
        cost = np.concatenate([[0.0], -gain / gain.max(), [0.0]])
        top = [(0.0, float(each)) for each in self._highest(allowed[1])]
        result = linprog(cost, A_ub=diags(size) @ rows, b_ub=bounds * size, bounds=top, method="highs-ds")
        if result.x is None:
            return None
        squared: Floats = np.maximum(result.x, _LEAST)
        squared[[0, -1]] = 0.0
        return squared

    def _highest(self, jerk: Floats) -> Floats:
        """Return the (G,) largest squared rates by the velocity limit and, near rest, by a constant jerk."""
        way = np.minimum(self._s, self._s[-1] - self._s)
        from_rest = (4.5 * jerk / self._steepest) ** (2 / 3) * way ** (4 / 3)
        near = np.minimum(np.arange(self._count), np.arange(self._count)[::-1]) < _FROM_REST
        highest: Floats = np.where(near, np.minimum(self._top, from_rest), self._top)
        return highest


def _fastest(limits: PathLimits, integrals: Sequence[PPoly]) -> Progress:
    """Return the fastest timing over integrals of the path length and widths of the moving average."""
    every = [
        _stretched(limits, Progress(integral=integral, rest=float(integral.x[-1]), width=width), _CHECK_PERIOD)
        for integral, width in product(integrals, _WIDTHS)
    ]
    return min(every, key=lambda each: each.duration)


def _stretched(limits: PathLimits, progress: Progress, period: float) -> Progress:
    """Stretch time as little as the limits need at samples of a period."""
    plain = replace(progress, stretch=1.0)
    return replace(plain, stretch=max(1.0, *(float(need.max()) for need in _stretches(limits, plain, period)[1:])))


def _stretches(limits: PathLimits, progress: Progress, period: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return (T,) path lengths and the factors of time that velocity, acceleration and jerk need there."""
    t = np.linspace(0.0, progress.duration, int(np.ceil(progress.duration / period)) + 1)
    s, *rates = progress(t)
    s = np.clip(s, 0.0, limits.s[-1])
    velocity, acceleration, jerk = (np.abs(each).max(axis=1) for each in joint_rates(limits.curve, s, *rates))
    of_acceleration, of_jerk = np.sqrt(acceleration / limits.acceleration), np.cbrt(jerk / limits.jerk)
    return s, velocity / limits.velocity_at(s), of_acceleration, of_jerk


def joint_rates(curve: CubicSpline, s: Floats, ds: Floats, dds: Floats, ddds: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the (T, 6) velocities, accelerations and jerks of the joints where a path is run.

    Args:
        curve: (6,) joint positions over the path's length [rad].
        s: (T,) path lengths [rad].
        ds: (T,) their first derivatives by time; ``dds`` and ``ddds`` are the second and the third.
        dds: See ``ds``.
        ddds: See ``ds``.
    """
    first, second, third = (curve(s, n) for n in (1, 2, 3))
    ds, dds, ddds = ds[:, None], dds[:, None], ddds[:, None]
    return first * ds, second * ds**2 + first * dds, third * ds**3 + 3 * second * ds * dds + first * ddds


def _lowered(limits: PathLimits, s: Floats, progress: Progress, allowed: Floats) -> Floats:
    """Lower the (2, G) limits of acceleration and jerk next to where a timing, not stretched, passes those given."""
    at, _, *needs = _stretches(limits, replace(progress, stretch=1.0), _CHECK_PERIOD)
    following, lower = np.clip(np.searchsorted(s, at), 1, len(s) - 1), []
    for given, most, need, order in zip(allowed, (limits.acceleration, limits.jerk), needs, (2, 3), strict=True):
        passed = np.ones(len(s))
        for grid_point in (following - 1, following):
            np.maximum.at(passed, grid_point, need**order)
        lower.append(np.clip(given / passed**_CORRECTION, _LEAST_SHARE * most, most))
    return np.stack(lower)


def _with_steps(s: Floats, squared: Floats) -> PPoly:
    """As :func:`_smooth`, with a constant acceleration between two grid points."""
    rate = np.sqrt(squared)
    time = 2 * np.diff(s) / (rate[:-1] + rate[1:])
    pieces = np.stack([np.diff(rate) / time / 2, rate[:-1], s[:-1]])
    return PPoly(pieces, np.concatenate([[0.0], np.cumsum(time)])).antiderivative()


def _smooth(s: Floats, squared: Floats) -> PPoly:
    """Return the integral over time of the path length whose squared rates at (G,) path lengths are given.

    The rate is a cubic spline over the times of the grid. Between two grid points, those follow from rates and
    accelerations at both; from and to rest, from a constant jerk.
    """
    rate, way = np.sqrt(squared), np.diff(s)
    before, after = way[:-1], way[1:]
    push = np.zeros(len(s))
    push[1:-1] = np.diff(squared)[:-1] * after / before + np.diff(squared)[1:] * before / after
    push[1:-1] /= 2 * (before + after)
    mean = (rate[:-1] + rate[1:]) / 2
    time = way / mean
    time[0], time[-1] = 3 * way[0] / rate[1], 3 * way[-1] / rate[-2]
    push[1], push[-2] = 2 * rate[1] / time[0], -2 * rate[-2] / time[-1]
    for _ in range(4):  # Newton's method on the way of a cubic with these rates and accelerations at its ends
        turn = (push[:-1] - push[1:]) / 12
        step = (time * mean + time**2 * turn - way) / np.maximum(mean + 2 * time * turn, 1e-3)
        time = np.clip(time - step, 0.3 * time, 3.0 * time)
    path_length = CubicSpline(np.concatenate([[0.0], np.cumsum(time)]), rate, bc_type="clamped").antiderivative()
    path_length.c *= s[-1] / float(path_length(path_length.x[-1]))
    return path_length.antiderivative()


def _refined(s: Floats) -> Floats:
    """Return at least a number of intervals, each a part of one of the (G,) path lengths'."""
    parts = int(np.ceil(_INTERVALS / (len(s) - 1)))
    places = np.arange(parts * (len(s) - 1) + 1) / parts
    return np.interp(places, np.arange(len(s)), s)


def _larger(a: Floats, b: Floats) -> Floats:
    """Return the elements of larger magnitude."""
    return np.where(np.abs(a) > np.abs(b), a, b)
