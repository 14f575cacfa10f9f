"""Detection of the rotations that map a part's surface onto itself.

A rotation is a symmetry when it moves no point of the surface further than the tolerance away from the surface. The
largest distance decides, not a mean or a percentile: a 5 mm hole is 0.5 % of a part's area and yet breaks a symmetry.
"""

import logging
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.optimize import minimize

from binpick_env.parts.surface import SurfaceProbe
from binpick_env.parts.symmetry_tolerance import check_symmetry_tolerance
from perception.geometry import Floats, require_shape, rotation_about, rotation_angle
from perception.part import Symmetry, diameter

log = logging.getLogger(__name__)
MAX_ORDER = 36  # largest order of an axis that is searched, such as that of a gear of 36 teeth
INERTIA_TOLERANCE = 0.02  # relative difference below which two moments of inertia may be equal
SAME_ROTATION = np.deg2rad(2.0)  # group elements closer than this are one; the smallest group step is 10 deg
MAX_ELEMENTS = 2 * MAX_ORDER  # largest group: that of a prism of the largest order
NEARLY = 3.0  # tolerances within which a rotation that is no symmetry is reported


@dataclass(frozen=True, kw_only=True)
class SymmetrySettings:
    """How closely a rotated surface must coincide with itself."""

    tolerance: float = 0.005  # largest deviation [d_max]: 0.4 mm at 80 mm, about what the camera resolves at 0.9 m
    metres: float | None = None  # the same, as a length [m], in place of ``tolerance``
    samples: int = 2000  # number of surface points that are rotated and measured

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 0.1:
            raise ValueError(f"tolerance must be in (0, 0.1) of d_max, got {self.tolerance}")
        if self.metres is not None:
            check_symmetry_tolerance(self.metres)
        if self.samples < 100:
            raise ValueError(f"samples must be at least 100, got {self.samples}")


@dataclass(frozen=True, kw_only=True)
class NearSymmetry:
    """A rotation about a part's centre that nearly maps its surface onto itself.

    Attributes:
        angle_deg: Angle of the rotation [deg].
        axis: Unit axis of the rotation, part axes.
        deviation: Largest distance between the turned surface and the still one [m].
        tolerance: Largest deviation of a symmetry [m].
    """

    angle_deg: float
    axis: tuple[float, float, float]
    deviation: float
    tolerance: float


def symmetry_error(mesh: trimesh.Trimesh, rotation: Floats, centre: Floats) -> float:
    """Return how far a mesh, turned about a point, deviates from itself [m].

    Args:
        mesh: Watertight mesh, part frame [m].
        rotation: (3, 3) rotation, part axes.
        centre: (3,) fixed point of the rotation, part frame [m].

    Returns:
        The two-sided Hausdorff distance over some 2000 surface samples and at most as many vertices.

    Note:
        Deterministic; some 50 ms. Use one :class:`SurfaceProbe` for many rotations.
    """
    require_shape("rotation", np.asarray(rotation), (3, 3))
    require_shape("centre", np.asarray(centre), (3,))
    return SurfaceProbe(mesh).error(np.asarray(rotation, dtype=np.float64), np.asarray(centre, dtype=np.float64))


def detect_symmetry(mesh: trimesh.Trimesh, settings: SymmetrySettings | None = None) -> Symmetry:
    """Find the group of proper rotations about the volume's centroid that map the surface onto itself.

    Every symmetry axis is a principal axis of inertia. These are three lines where the moments differ. Where two
    moments agree, axes may lie anywhere in a plane; where three agree, anywhere. Candidates are then swept and refined.

    Args:
        mesh: Watertight mesh, part frame [m].
        settings: Tolerance and number of samples.

    Returns:
        The group: trivial, cyclic, dihedral (orders 2 to `MAX_ORDER`), polyhedral, a continuous axis with or without a
        flip, or every rotation (a ball).

    Note:
        Deterministic; 0.1 to 5 s, the longest for a cube's equal moments. One line of the log names the rotation that
        comes nearest to a symmetry, if it deviates by less than `NEARLY` tolerances.
    """
    return _Search(mesh, settings or SymmetrySettings()).group()


def near_symmetry(
    mesh: trimesh.Trimesh, found: Symmetry, settings: SymmetrySettings | None = None
) -> NearSymmetry | None:
    """Return the turn about a principal axis that comes nearest to a symmetry without being one.

    Turns by a half down to a sixth of a full turn are measured, those of a continuous axis or a ball never.

    Args:
        mesh: Watertight mesh, part frame [m].
        found: Symmetry group of the mesh.
        settings: Tolerance and number of samples.

    Returns:
        The turn; None where none deviates by less than `NEARLY` tolerances.

    Note:
        Deterministic; some tenths of a second.
    """
    if found.axis is not None or found.sphere:
        return None
    return _Search(mesh, settings or SymmetrySettings()).nearest(found.rotations)


class _Search:
    """One detection: the probe, the tolerance and the candidates of one mesh."""

    def __init__(self, mesh: trimesh.Trimesh, settings: SymmetrySettings) -> None:
        self.probe = SurfaceProbe(mesh, samples=settings.samples)
        self.centre: Floats = np.asarray(mesh.center_mass, dtype=np.float64)
        d_max = diameter(mesh.vertices)
        self.tolerance = settings.tolerance * d_max if settings.metres is None else settings.metres
        if self.tolerance >= 0.1 * d_max:
            raise ValueError(
                f"symmetry_tolerance must be under a tenth of d_max, {0.1 * d_max:.3g} m, got {self.tolerance:.3g} m"
            )
        self.moments, axes = np.linalg.eigh(mesh.moment_inertia)
        self.axes: Floats = axes.T

    def fits(self, axis: Floats, angle: float) -> bool:
        """Tell whether the turn about the centre is a symmetry."""
        return self.probe.fits(rotation_about(axis, angle), self.centre, self.tolerance)

    def group(self) -> Symmetry:
        """Find a continuous axis, or else generate the finite group from the axes that fit."""
        low, middle, high = self.moments
        pairs = (middle - low < INERTIA_TOLERANCE * high, high - middle < INERTIA_TOLERANCE * high)
        round_axes = [axis for axis in self.axes if any(pairs) and self._is_round(axis)]
        if len(round_axes) > 1:
            log.info("the part is a ball: its orientation is free")
            return Symmetry(sphere=True)
        if round_axes:
            return self._revolved(round_axes[0])
        generators = [turn for axis in self.axes for turn in self._turns(axis)]
        if all(pairs):
            for angle in (np.pi, 2 * np.pi / 3):  # the half turns of a tetrahedron do not make its thirds
                generators += [turn for axis in self._swept(_hemisphere(), angle) for turn in self._turns(axis)]
        elif any(pairs):
            # The lone moment's axis is certain, and one half turn across it makes all the others.
            u, v = self.axes[:2] if pairs[0] else self.axes[1:]
            angles = np.deg2rad(np.arange(0.0, 180.0, 1.0))
            directions = np.cos(angles)[:, None] * u + np.sin(angles)[:, None] * v
            generators += [rotation_about(axis, np.pi) for axis in self._swept(directions, np.pi, enough=1)]
        found = self._closed(generators)
        self._report_near_symmetry(found)
        return Symmetry(rotations=found)

    def nearest(self, found: Floats) -> NearSymmetry | None:
        """Return the turn about a principal axis that comes nearest to a symmetry; None if none is near."""
        nearest = None
        least = NEARLY * self.tolerance
        for axis in self.axes:
            for order in range(2, 7):
                rotation = rotation_about(axis, 2 * np.pi / order)
                if rotation_angle(found @ rotation.T).min() < SAME_ROTATION:
                    continue
                few = self.probe.turned(rotation, self.centre, stride=20)
                error = self.probe.error(rotation, self.centre) if self.probe.distance(few).max() < least else np.inf
                if error < least:
                    least = error
                    x, y, z = axis.tolist()
                    nearest = NearSymmetry(
                        angle_deg=360 / order, axis=(x, y, z), deviation=error, tolerance=self.tolerance
                    )
        return nearest

    def _report_near_symmetry(self, found: Floats) -> None:
        """Log the turn about a principal axis that comes nearest to a symmetry, and what was not searched."""
        near = self.nearest(found)
        if near is not None:
            log.info(
                "no symmetry, but nearly: a turn by %.0f deg about %s deviates by %.2f mm, the tolerance is %.2f mm; "
                "--symmetry-tolerance, in Python symmetry_tolerance= [m], changes it",
                near.angle_deg,
                np.round(near.axis, 2).tolist(),
                near.deviation * 1e3,
                self.tolerance * 1e3,
            )
        group = f"{len(found)} rotations map" if len(found) > 1 else "no rotation maps"
        log.info("%s the part onto itself; orders above %d are unsearched", group, MAX_ORDER)

    def _is_round(self, axis: Floats) -> bool:
        golden = np.pi * (3 - np.sqrt(5))  # multiples of the golden angle avoid every polygon's own steps
        return all(self.fits(axis, k * golden) for k in range(1, 9))

    def _revolved(self, axis: Floats) -> Symmetry:
        axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
        across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        flip = rotation_about(across, np.pi)
        rotations = np.stack([np.eye(3), flip]) if self.fits(across, np.pi) else np.eye(3)[None]
        return Symmetry(rotations=rotations, axis=axis)

    def _turns(self, axis: Floats) -> list[Floats]:
        """Return the smallest turn about ``axis`` that fits, or none."""
        order = next((n for n in range(MAX_ORDER, 1, -1) if self.fits(axis, 2 * np.pi / n)), None)
        return [] if order is None else [rotation_about(axis, 2 * np.pi / order)]

    def _swept(self, directions: Floats, angle: float, *, enough: int = 12) -> list[Floats]:
        """Return up to ``enough`` axes, refined from (N, 3) directions, about which a turn by ``angle`` fits."""
        costs = np.array([self.cost(d, angle) for d in directions])
        near = np.abs(directions @ directions.T) > np.cos(np.deg2rad(7.0))
        minima = np.flatnonzero(costs <= np.where(near, costs, np.inf).min(axis=1))
        found: list[Floats] = []
        for i in minima[np.argsort(costs[minima])]:
            axis = self._refined(directions[i], angle)
            if self.fits(axis, angle) and not any(abs(axis @ other) > np.cos(SAME_ROTATION) for other in found):
                found.append(axis)
            if len(found) == enough:
                break
        return found

    def cost(self, axis: Floats, angle: float) -> float:
        """Return the mean distance [m] between the turned surface and the still one; smooth, for searching only."""
        points = self.probe.turned(rotation_about(axis, angle), self.centre, stride=20)
        return float(np.mean(self.probe.distance(points)))

    def _refined(self, axis: Floats, angle: float) -> Floats:
        """Tilt ``axis`` to where the turned surface fits best."""
        tilts = np.linalg.svd(axis[None])[2][1:]
        start = np.vstack([np.zeros(2), 0.03 * np.eye(2)])

        def cost(tilt: Floats) -> float:
            return self.cost(axis + tilt @ tilts, angle)

        best = minimize(
            cost,
            np.zeros(2),
            method="Nelder-Mead",
            options={"initial_simplex": start, "xatol": 1e-4, "fatol": 1e-7, "maxfev": 60},
        )
        refined = axis + np.asarray(best.x) @ tilts
        return np.asarray(refined / np.linalg.norm(refined))

    def _closed(self, generators: list[Floats]) -> Floats:
        """Return the group of the generators; one is left out where a product would not fit the surface.

        The deviations of two turns add up in their product, which may therefore reach twice the tolerance.
        """
        group = np.eye(3)[None]
        kept: list[Floats] = []
        for generator in generators:
            if rotation_angle(group @ generator.T).min() <= SAME_ROTATION:
                continue
            larger = _products([*kept, generator])
            if larger is None or any(self.probe.error(g, self.centre) > 2 * self.tolerance for g in larger):
                log.warning("a turn that fits the surface was left out, as its products with the others do not fit it")
                continue
            kept.append(generator)
            group = larger
        return group


def _products(generators: list[Floats]) -> Floats | None:
    """Return the (G, 3, 3) group that generators make, the identity first; None if it has too many elements."""
    group: list[Floats] = [np.eye(3)]
    for element in group:
        for generator in generators:
            product = element @ generator
            if rotation_angle(np.array(group) @ product.T).min() > SAME_ROTATION:
                if len(group) == MAX_ELEMENTS:
                    return None
                group.append(product)
    return np.stack(group)


def _hemisphere() -> Floats:
    """Return (N, 3) unit directions some 5 deg apart, one of each opposite pair."""
    directions = np.asarray(trimesh.creation.icosphere(subdivisions=4).vertices)
    kept: Floats = directions[directions @ np.array([0.11, 0.23, 1.0]) > 0]
    return kept
