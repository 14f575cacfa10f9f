"""Pair features of edge points, boundary to boundary by tangent lines (B2B-TL), and the table of a part's pairs.

Source: PPF-MEAM (Liu et al., Sensors 18(8):2719, 2018), reconstructed from its abstract. Of an ordered pair (r, i) with
``d = p_i - p_r`` the feature is ``|d|`` and the angles between d and either tangent and between the tangents. A
tangent is a line, its sign is arbitrary: each is turned towards d first, and the table keeps the sign that was needed.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape, rotation_about
from perception.part import Symmetry
from perception.pose.model._pair_kernels import FeatureGrid, Ints, Votes, model_pairs, tangent_frames

# An entry's weight is a whole number of 1 / WEIGHT_ONE, so that sums are exact: 30 000 scene points stay below 2**31.
WEIGHT_ONE = 1024
_MAX_CELLS = 1 << 24


@dataclass(frozen=True, kw_only=True)
class PairConfig:
    """Cells of the pair feature; lengths are shares of the part's ``d_max``.

    Attributes:
        distance_step: Width of a cell of ``|d|``.
        angle_step: Width of a cell of each angle [rad].
        distance_noise: A look-up also takes the neighbouring cell if its border is within this; 0 for never.
        angle_noise: The same for angles [rad].
        radius: Longest pair.
        nearest: Shortest pair; below it noise decides the direction of d.
        collinear: Pairs whose d is within this angle of the reference's tangent are left out [rad]: they say nothing
            about the turn round it.
        same_view: Only pairs that are edges of a common view; False for every pair.
        weighting: What an entry counts: "inverse" 1 / entries of its cell, "capped" the same but 1 up to
            ``weight_cap`` times the median cell, "none" 1. Parallel straight edges fill few cells with many entries;
            but equal entries are kept once, which removes most of the slide along them, and weights did not help more.
        weight_cap: See ``weighting``.
        signs: "safe" as told at the top of this module. For comparison: "no_flip" forgets the sign that was needed and
            takes every two tangents to point the same way; "raw" takes tangents' signs as they come.
        orbit_distance: Model points that a symmetry brings this close share one accumulator row ...
        orbit_angle: ... if their tangents agree within this [rad].

    Note:
        Defaults by trial on true segments of rendered bins, 14 groups of each of five parts: the share of reference
        points that gave the right pose was 0.62 with "none", 0.61 with "capped" at 20, 0.55 at 5 and 0.27 with
        "inverse"; 0.62 with look-ups spread by 3 degrees, 0.59 without; spread in distance cost time only.
    """

    distance_step: float = 0.035
    angle_step: float = math.radians(12)
    distance_noise: float = 0.0
    angle_noise: float = math.radians(3)
    radius: float = 1.0
    nearest: float = 0.05
    collinear: float = math.radians(6)
    same_view: bool = True
    weighting: Literal["inverse", "capped", "none"] = "none"
    weight_cap: float = 20.0
    signs: Literal["safe", "no_flip", "raw"] = "safe"
    orbit_distance: float = 0.01
    orbit_angle: float = math.radians(8)

    def __post_init__(self) -> None:
        for name, high in (("distance_step", 1.0), ("angle_step", math.pi / 2), ("radius", 1.0)):
            if not 0 < getattr(self, name) <= high:
                raise ValueError(f"{name} must be in (0, {high:.4g}], got {getattr(self, name)}")
        for name, high in (
            # More than half a cell of noise would reach over two borders at once: 2**4 cells are the most.
            ("distance_noise", self.distance_step / 2),
            ("angle_noise", self.angle_step / 2),
            ("nearest", self.radius),
            ("collinear", math.pi / 4),
            ("orbit_angle", math.pi / 4),
        ):
            if not 0 <= getattr(self, name) <= high:
                raise ValueError(f"{name} must be in [0, {high:.4g}], got {getattr(self, name)}")
        if self.weighting not in ("inverse", "capped", "none"):
            raise ValueError(f"weighting must be 'inverse', 'capped' or 'none', got {self.weighting!r}")
        if self.signs not in ("safe", "no_flip", "raw"):
            raise ValueError(f"signs must be 'safe', 'no_flip' or 'raw', got {self.signs!r}")
        for name in ("weight_cap", "orbit_distance"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if self.cells > _MAX_CELLS:
            raise ValueError(f"distance_step and angle_step give {self.cells} cells, at most {_MAX_CELLS}")

    @property
    def cells(self) -> int:
        """Number of cells of the table."""
        grid = self.grid(1.0)
        return grid.distances * grid.inclinations**2 * grid.half_turns

    def grid(self, d_max: float) -> FeatureGrid:
        """Return the cells for a part of diameter ``d_max`` [m]."""
        folded = self.signs != "raw"
        return FeatureGrid(
            distance_step=self.distance_step * d_max,
            angle_step=self.angle_step,
            distance_noise=self.distance_noise * d_max,
            angle_noise=self.angle_noise,
            nearest=self.nearest * d_max,
            collinear=self.collinear,
            # One more than radius / step, for pairs of exactly that length and a little noise.
            distances=math.floor(self.radius / self.distance_step + 1e-9) + 1,
            inclinations=math.ceil((math.pi / 2 if folded else math.pi) / self.angle_step - 1e-9),
            half_turns=math.ceil(math.pi / self.angle_step - 1e-9),
            folded=folded,
            flips=self.signs == "safe",
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class PairTable:
    """A part's pairs, sorted by cell, and the model points that are the rows of an accumulator.

    Attributes:
        points: (R, 3) model point of each row, part frame [m].
        frames: (R, 3, 3) rotation that maps its tangent to x.
        rows: (M,) row of each edge point that the table was built of, -1 for one that was dropped.
        offsets: (C + 1,) int32, where each cell's entries begin.
        entries: (E,) uint32 ``row << 9 | sign << 8 | angle``, see :func:`._pair_kernels.model_pairs`.
        weights: (C,) int32 weight of a cell's entries, in 1 / ``WEIGHT_ONE``.
        grid: The cells.
        centre: (3,) where poses are compared, part frame [m].
        d_max: Diameter of the part [m].
    """

    points: Floats
    frames: Floats
    rows: Ints
    offsets: NDArray[np.int32]
    entries: NDArray[np.uint32]
    weights: Votes
    grid: FeatureGrid
    centre: Floats
    d_max: float


def build_table(
    points: Floats,
    tangents: Floats,
    visibility: NDArray[np.uint32],
    d_max: float,
    config: PairConfig | None = None,
    *,
    symmetry: Symmetry | None = None,
    centre: Floats | None = None,
) -> PairTable:
    """Put all admissible ordered pairs of a part's edge points into a table.

    With a symmetry, the points that it maps onto each other share one accumulator row (their votes would be split
    over equivalent poses otherwise); equal entries of a row are kept once.

    Args:
        points: (M, 3) edge points, part frame [m].
        tangents: (M, 3) directions of their edges, of either sign and any length; points with none are dropped.
        visibility: (M,) uint32, bit v set where the point is an edge of view v.
        d_max: Diameter of the part [m].
        config: Cells and weights.
        symmetry: The part's; None for no merging.
        centre: (3,) the point that the symmetry fixes; the points' mean if left out.

    Returns:
        The table; empty, but valid, when no pair is admissible.

    Note:
        Deterministic; 0.1 s for 600 points.
    """
    config = config or PairConfig()
    require_shape("points", points, (None, 3))
    require_shape("tangents", tangents, (len(points), 3))
    require_shape("visibility", visibility, (len(points),))
    if not 0 < d_max < math.inf:
        raise ValueError(f"d_max must be positive, got {d_max}")
    kept = usable(points, tangents)
    units = unit(tangents[kept])
    part_points = np.ascontiguousarray(points[kept], dtype=np.float64)
    if centre is None:
        centre = part_points.mean(axis=0) if len(part_points) else np.zeros(3)
    require_shape("centre", centre, (3,))
    members, turns, heads = _orbits(part_points - centre, units, symmetry or Symmetry(), config, d_max)
    # A member's pairs are seen in the frame of its row's head, with its tangent pointing the head's way.
    signs = np.where(np.einsum("mij,mj,mi->m", turns, units, units[heads][members]) < 0, -1.0, 1.0)
    frames = tangent_frames(units[heads])
    mask = np.asarray(visibility[kept] if config.same_view else np.ones(len(kept)), dtype=np.uint32)
    grid = config.grid(d_max)
    pairs = model_pairs(part_points, units * signs[:, None], frames[members] @ turns, members, mask, grid)
    pairs = np.unique(pairs)
    counts = np.bincount(pairs >> 32, minlength=config.cells)
    rows = np.full(len(points), -1, dtype=np.int64)
    rows[kept] = members
    return PairTable(
        points=part_points[heads],
        frames=frames,
        rows=rows,
        offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        entries=(pairs & 0xFFFFFFFF).astype(np.uint32),
        weights=_weights(counts, config),
        grid=grid,
        centre=np.array(centre, dtype=np.float64),
        d_max=float(d_max),
    )


def usable(points: Floats, tangents: Floats) -> Ints:
    """Return the indices of the points that are finite and have a finite direction."""
    norm = np.linalg.norm(tangents, axis=1)
    return np.flatnonzero(np.isfinite(points).all(axis=1) & np.isfinite(norm) & (norm > 1e-9))


def unit(vectors: Floats) -> Floats:
    """Return (N, 3) vectors scaled to length 1."""
    scaled: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.ascontiguousarray(scaled, dtype=np.float64)


def _weights(counts: Ints, config: PairConfig) -> Votes:
    """Return (C,) whole-numbered weights of cells with ``counts`` entries; at least 1."""
    filled = counts[counts > 0]
    if config.weighting == "none" or len(filled) == 0:
        return np.full(len(counts), WEIGHT_ONE, dtype=np.int32)
    free = config.weight_cap * float(np.median(filled)) if config.weighting == "capped" else 1.0
    weights: Votes = np.maximum(np.rint(WEIGHT_ONE * np.minimum(1.0, free / np.maximum(counts, 1))), 1).astype(np.int32)
    return weights


def _orbits(
    offsets: Floats, tangents: Floats, symmetry: Symmetry, config: PairConfig, d_max: float
) -> tuple[Ints, Floats, Ints]:
    """Group points that the symmetry maps onto each other.

    Args:
        offsets: (M, 3) points relative to the fixed point.
        tangents: (M, 3) unit.
        symmetry: The group.
        config: Tolerances.
        d_max: Their unit [m].

    Returns:
        (M,) orbit of each point; (M, 3, 3) the group's rotation that brings it to its orbit's head; (R,) the heads,
        the first point of each orbit.
    """
    members, turns = np.arange(len(offsets)), np.tile(np.eye(3), (len(offsets), 1, 1))
    if symmetry.order == 1 or len(offsets) == 0:
        return members, turns, members
    # Each point under each rotation of the group; a continuous axis turns it to the half-plane of azimuth 0.
    rotations = np.repeat(symmetry.rotations[None], len(offsets), axis=0)
    if symmetry.axis is not None:
        rotations = _to_half_plane(rotations, offsets, tangents, symmetry.axis, config.orbit_distance * d_max)
    places = np.einsum("msij,mj->msi", rotations, offsets)
    directions = np.einsum("msij,mj->msi", rotations, tangents)
    cosine = math.cos(config.orbit_angle)
    heads: list[int] = []
    for m in range(len(offsets)):
        # The head stands where its own first rotation puts it.
        far = np.linalg.norm(places[m] - places[heads, 0][:, None], axis=-1)
        along = np.abs(np.sum(directions[m] * directions[heads, 0][:, None], axis=-1))
        fits = np.argwhere((far <= config.orbit_distance * d_max) & (along >= cosine))
        orbit, s = fits[0] if len(fits) else (len(heads), 0)
        if not len(fits):
            heads.append(m)
        members[m] = orbit
        turns[m] = rotations[heads[orbit], 0].T @ rotations[m, s]
    return members, turns, np.array(heads, dtype=np.int64)


def _to_half_plane(rotations: Floats, offsets: Floats, tangents: Floats, axis: Floats, reach: float) -> Floats:
    """Return (M, S, 3, 3) rotations followed by the turn about ``axis`` that brings the point to azimuth 0.

    Points within ``reach`` of the axis have no azimuth of their own: their tangent's is taken.
    """
    frame = tangent_frames(np.ascontiguousarray(axis[None], dtype=np.float64))[0]
    out = np.empty_like(rotations)
    for m, s in np.ndindex(rotations.shape[:2]):
        y, z = frame[1:] @ rotations[m, s] @ offsets[m]
        if math.hypot(y, z) <= reach:
            y, z = frame[1:] @ rotations[m, s] @ tangents[m]
        out[m, s] = rotation_about(axis, -math.atan2(z, y)) @ rotations[m, s]
    return out
