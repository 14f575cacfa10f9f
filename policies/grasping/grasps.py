"""Grasps on a part: sampled once on its mesh, checked against the part, thinned to an even cover, cached."""

import logging
from dataclasses import dataclass, fields, replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from binpick_env.config import GRIPPER_STROKE
from perception.geometry import Floats, make_transform
from perception.part import PartModel
from perception.runtime.cache import Arrays, cached_arrays, digest
from policies.grasping.antipodal import Contacts, Solid, close_pads, grasps_on_lines, opposite_faces
from policies.grasping.gripper import PAD_SIZE, GripperModel, gripper_model
from policies.grasping.outcomes import Grasp
from policies.grasping.thin_parts import BroadSides

_log = logging.getLogger(__name__)
_VERSION = 8  # raised whenever the code below would give another set
_SURFACE_DENSITY = 1.5e6  # points per square metre: six in a cell of 2 mm
_SYMMETRY_STEPS = 24  # rotations that stand for a continuous symmetry axis
_WIDTH_MARGIN = 0.007  # distance of `max_width` from the jaw's largest opening: the smallest extra, twice, and below
_OPENING_MARGIN = 0.001  # distance of `max_opening` from the jaw's largest opening [m]
_FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class GraspSettings:
    """How grasps are sampled and judged. Lengths [m]."""

    samples: int = 1500  # number of surface points that lines are cast from
    turns: int = 16  # number of approach directions about each line
    depths: tuple[float, ...] = (0.0, 0.003, 0.007, 0.012, 0.018)  # distances of the fingertips beyond the contact line
    friction: float = 0.4  # friction coefficient of the cone; the pads' own is 0.6 to 0.7
    min_width: float = 0.003  # least distance between the pads at contact
    max_width: float = 0.078  # largest distance between the pads at contact
    extras: tuple[float, ...] = (0.003, 0.005, 0.008, 0.012)  # room beside the part: openings are width + twice this
    max_opening: float = 0.084  # largest distance between the pads on the approach; the stroke is 0.085
    part_margin: float = 0.001  # distance of the open gripper from the part
    side_margin: float = 0.002  # room beside a closed pad; a pad wedged between two collars does not release the part
    min_area: float = 0.04  # least share of a pad's face that touches the part, if the part is not thin
    thin: float = 0.012  # thickness under which a part is thin: the contact is then searched more finely
    max_grasps: int = 4000  # largest number of grasps kept
    max_checked: int = 20000  # largest number of poses whose pads are closed, drawn evenly from the collision-free ones

    def __post_init__(self) -> None:
        for name in ("samples", "turns", "max_grasps", "max_checked"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not self.thin > 0:
            raise ValueError(f"thin must be positive, got {self.thin}")
        if not 0 < self.friction < 2:
            raise ValueError(f"friction must be in (0, 2), got {self.friction}")
        if not 0 < self.min_width < self.max_width < self.max_opening:
            widths = self.min_width, self.max_width, self.max_opening
            raise ValueError(f"0 < min_width < max_width < max_opening is required, got {widths}")
        if not self.depths or not self.extras or list(self.extras) != sorted(self.extras) or min(self.extras) <= 0:
            raise ValueError(f"depths must not be empty and extras must rise from above 0, got {self.extras}")

    def limited_to(self, jaw: float) -> "GraspSettings":
        """Return the settings for a jaw that opens no wider than ``jaw`` [m], with the margins of the whole stroke."""
        if jaw - _WIDTH_MARGIN <= self.min_width:
            least = 1000 * (self.min_width + _WIDTH_MARGIN)
            raise ValueError(f"jaw must exceed {least:.0f} mm to grasp anything, got {1000 * jaw:.1f} mm")
        return replace(
            self,
            max_width=min(self.max_width, jaw - _WIDTH_MARGIN),
            max_opening=min(self.max_opening, jaw - _OPENING_MARGIN),
        )

    @property
    def min_cosine(self) -> float:
        """Cosine of the friction cone's half angle."""
        return float(np.cos(np.arctan(self.friction)))


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspSet:
    """Grasps on one part, best first. The jaw turned by half a turn about its approach is the same grasp.

    Attributes:
        T_part_grasp: (G, 4, 4) grasp frame in the part frame, see :class:`policies.grasping.outcomes.Grasp`.
        width: (G,) distance between the pads at contact [m].
        quality: (G,) quality of the grasp on the lone part in [0, 1].
        extras: (E,) room beside the part [m], rising; the openings tried are the width plus twice this.
        clear: (G, E) whether approach and closing at this opening keep clear of the part itself.
        surface: (S, 3) points spread over the part's surface, part frame [m].
    """

    T_part_grasp: Floats
    width: Floats
    quality: Floats
    extras: Floats
    clear: NDArray[np.bool_]
    surface: Floats

    def __len__(self) -> int:
        return len(self.width)

    def __getitem__(self, index: int) -> Grasp:
        return Grasp(
            T_part_grasp=self.T_part_grasp[index],
            width=float(self.width[index]),
            quality=float(self.quality[index]),
        )

    def take(self, index: NDArray[np.int64]) -> "GraspSet":
        """Return the grasps at (M,) indices."""
        kept = {name: getattr(self, name)[index] for name in ("T_part_grasp", "width", "quality", "clear")}
        return GraspSet(**kept, extras=self.extras, surface=self.surface)


def flip(T_a_grasp: Floats) -> Floats:
    """Turn (..., 4, 4) grasps by half a turn about their approach: the same for the part, not for the arm."""
    return T_a_grasp @ _FLIP


def sample_grasps(
    model: PartModel, settings: GraspSettings | None = None, seed: int = 0, *, jaw: float | None = None
) -> GraspSet:
    """Return the part's grasps from the cache, or sample, check, rate and thin them.

    Args:
        model: Any watertight part.
        settings: Sampling and limits; the defaults if None.
        seed: Seed of the surface samples.
        jaw: Largest opening of the jaw [m]; the gripper's whole stroke if None.

    Returns:
        At most ``max_grasps``; empty, with a logged warning that counts what each filter left, if the jaw fits nowhere.

    Note:
        Deterministic. Seconds when computed, milliseconds from the cache.
    """
    settings = _settings_for(settings, jaw)
    gripper = gripper_model(jaw)
    mesh = np.asarray(model.mesh.vertices), np.asarray(model.mesh.faces)
    group = model.symmetry.elements(_SYMMETRY_STEPS)
    key = digest(_VERSION, trimesh.__version__, settings, seed, *mesh, group, model.centre, gripper.points)
    names = [f.name for f in fields(GraspSet)]

    def compute() -> Arrays:
        found = _compute(model, settings, gripper, seed)
        return {name: getattr(found, name) for name in names}

    arrays = cached_arrays("grasps", key, compute)
    return GraspSet(**{name: arrays[name] for name in names})


def least_width(model: PartModel, settings: GraspSettings | None = None) -> float:
    """Return the distance between the nearest two opposite faces that a jaw of any stroke could hold [m].

    It is infinite if the part has no two opposite faces.

    Args:
        model: Any watertight part.
        settings: Sampling, and the smallest width; the defaults if None.
    """
    settings = settings or GraspSettings()
    widths = settings.min_width, np.inf
    first, second = opposite_faces(model.mesh, settings.samples, settings.min_cosine, widths, seed=0)
    return float(np.linalg.norm(second - first, axis=1).min(initial=np.inf))


def why_no_grasp(model: PartModel, settings: GraspSettings | None = None, *, jaw: float | None = None) -> str:
    """Return why :func:`sample_grasps` found nothing on a part, as a sentence for an error message."""
    settings = _settings_for(settings, jaw)
    least = least_width(model, settings)
    found = f"the jaw (stroke {1000 * gripper_model(jaw).stroke:.0f} mm) finds no grasp on {model.name!r}: "
    if settings.max_width < least < np.inf:
        return (
            f"{found}it takes at most {1000 * settings.max_width:.0f} mm between two opposite faces, "
            f"and the nearest two are {1000 * least:.0f} mm apart"
        )
    text = f"{found}it needs two opposite faces that its pads can reach"
    if jaw is not None and jaw < GRIPPER_STROKE:
        wider = sample_grasps(model).width
        if len(wider):
            stroke, least = 1000 * GRIPPER_STROKE, 1000 * wider.min()
            text += (
                f"; its whole stroke of {stroke:.0f} mm finds grasps from {least:.0f} mm on: use a wider jaw (--jaw)"
            )
    return text


def _settings_for(settings: GraspSettings | None, jaw: float | None) -> GraspSettings:
    settings = settings or GraspSettings()
    return settings if jaw is None else settings.limited_to(jaw)


def _compute(model: PartModel, settings: GraspSettings, gripper: GripperModel, seed: int) -> GraspSet:
    mesh, rng = model.mesh, np.random.default_rng(seed)
    scale = _contact_scale(mesh, settings)
    widths = settings.min_width, settings.max_width
    lines = opposite_faces(mesh, round(settings.samples / scale), settings.min_cosine, widths, seed)
    T, width = grasps_on_lines(*lines, settings.turns, settings.depths)
    broad_sides = BroadSides.of_thin_part(mesh, settings.thin)
    T_floor, width_floor = broad_sides.grasps_off_the_floor(*lines, settings.part_margin)
    T, width = np.concatenate([T_floor, T]), np.concatenate([width_floor, width])
    counts = {"lines through the part": len(lines[0]), "poses": len(T)}
    solid = Solid.from_mesh(mesh)

    # The pads may touch more than the two points of the line. So: a rough check, exact closing, then the full check.
    opening = np.minimum(width + 2 * settings.extras[0], settings.max_opening)
    rough = solid.clear(gripper.tcp_from_grasp(T, width), opening, gripper, margin=0.0, pad_margin=0.0)
    chosen = np.flatnonzero(rough)
    counts["clear of the part when open"] = len(chosen)
    if len(chosen) > settings.max_checked:
        off_floor, others = chosen[chosen < len(T_floor)], chosen[chosen >= len(T_floor)]
        off_floor = _drawn(off_floor, max(settings.max_checked // 4, settings.max_checked - len(others)), rng)
        chosen = np.append(off_floor, _drawn(others, settings.max_checked - len(off_floor), rng))
    T, contacts = T[chosen], close_pads(mesh, T[chosen], width[chosen], scale)
    T[:, :3, 3] += contacts.shift[:, None] * T[:, :3, 1]
    firm = (contacts.area >= scale**2 * settings.min_area) & (contacts.alignment >= settings.min_cosine)
    firm &= (contacts.width >= settings.min_width) & (contacts.width <= settings.max_width)
    firm &= contacts.offset <= settings.friction * np.maximum(contacts.width, 0.01)
    counts["firm contact"] = int(firm.sum())

    quality = _quality(T, contacts, model, settings)
    T, width, quality = T[firm], contacts.width[firm], quality[firm]
    clear = _clear_openings(solid, T, width, gripper, settings)
    counts["clear while closing"] = int(clear.any(axis=1).sum())
    kept = np.flatnonzero(clear.any(axis=1) & _comes_free(solid, T, width, settings.side_margin))
    counts["not wedged"] = len(kept)
    surface, _ = trimesh.sample.sample_surface(mesh, max(int(mesh.area * _SURFACE_DENSITY), 1000), seed=seed)
    found = GraspSet(
        T_part_grasp=T, width=width, quality=quality, clear=clear, extras=np.array(settings.extras), surface=surface
    ).take(kept)
    if len(found) == 0:
        left = ", ".join(f"{count} {name}" for name, count in counts.items())
        _log.info("no grasp on %s; left after each step of the search: %s", model.name, left)
        return found

    def spread(grasps: GraspSet) -> GraspSet:
        shallow = broad_sides.shallow(grasps.T_part_grasp, grasps.width, settings.part_margin)
        return grasps.take(_spread(grasps, settings.max_grasps, shallow))

    return spread(_replicate(spread(found), model))


def _drawn(indices: NDArray[np.int64], count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return at most ``count`` of (N,) rising indices, drawn evenly, rising."""
    return indices if len(indices) <= count else np.sort(rng.choice(indices, count, replace=False))


def _contact_scale(mesh: trimesh.Trimesh, settings: GraspSettings) -> float:
    """Return how much finer the contacts on a thin part are searched, in [0.5, 1]: 1 for a part that is not thin.

    A plate of 4 mm on the floor is held by the last 3 mm of the pads, which rays 4 mm apart do not resolve.
    """
    thickness = float(mesh.bounding_box_oriented.primitive.extents.min())
    return float(np.clip(thickness / settings.thin, 0.5, 1.0))


def _clear_openings(
    solid: Solid, T_part_grasp: Floats, width: Floats, gripper: GripperModel, settings: GraspSettings
) -> NDArray[np.bool_]:
    """Return (N, E): whether approach, closing and contact cut nothing of the part but what the pads press on."""
    T_part_tcp = gripper.tcp_from_grasp(T_part_grasp, width)
    margin = settings.part_margin

    def narrow(clear: NDArray[np.bool_], gap: Floats, margin: float, pad_margin: float, retreat: float = 0.0) -> None:
        todo = np.flatnonzero(clear)
        margins = {"margin": margin, "pad_margin": pad_margin}
        clear[todo] = solid.clear(T_part_tcp[todo], gap[todo], gripper, retreat=retreat, **margins)

    # At contact the pads' faces lie on the part, and tilted by up to 2 degrees; the distance is good to half a voxel.
    closes = np.ones(len(width), dtype=np.bool_)
    narrow(closes, width, 0.5 * margin, -1.0e-3)
    columns = []
    for extra in settings.extras:
        opening = width + 2 * extra
        for gap in (width + extra, opening):  # closing from a wider opening passes through these as well
            narrow(closes, gap, 0.0, 0.0)
        clear = closes & (opening <= settings.max_opening)
        for retreat in (0.0, 0.02, 0.045):
            narrow(clear, opening, margin, margin, retreat)
        columns.append(clear)
    return np.stack(columns, axis=1)


def _comes_free(solid: Solid, T_part_grasp: Floats, width: Floats, margin: float) -> NDArray[np.bool_]:
    """Return the (N,) mask of grasps without any of the part within ``margin`` [m] beside the closed pads."""
    across, thickness, length = PAD_SIZE[0] / 2 + margin, PAD_SIZE[1], PAD_SIZE[2]
    depth = np.linspace(0.0015, thickness, 4)  # behind the pad's face; the first millimetre is what the pad presses on
    x, y, z = np.meshgrid([-across, across], depth, np.linspace(-length, margin, 16), indexing="ij")
    free = np.ones(len(width), dtype=np.bool_)
    for side in (-1.0, 1.0):
        for at in np.stack([x, side * y, z], axis=-1).reshape(-1, 3):
            point = np.tile(at, (len(width), 1))
            point[:, 1] += side * width / 2
            points_part = np.einsum("nij,nj->ni", T_part_grasp[:, :3, :3], point) + T_part_grasp[:, :3, 3]
            free &= solid.distance(points_part) > 0
    return free


def _quality(T: Floats, contacts: Contacts, model: PartModel, settings: GraspSettings) -> Floats:
    """Return (N,) qualities in [0, 1]: the weighted geometric mean of five terms in (0, 1].

    They rate the contact patch, its alignment, the lever of gravity, how far the patches lie opposite, and the spare
    width. The lever is the distance of the part's centre from the axis through both patches, about which it would turn.
    """
    axis_point = T[:, :3, 3] + np.einsum("nij,nj->ni", T[:, :3, [0, 2]], contacts.middle)
    to_centre = model.centre - axis_point
    lever = np.linalg.norm(np.cross(to_centre, T[:, :3, 1]), axis=1)
    spare = (settings.max_opening - contacts.width) / 0.010  # 10 mm to spare is plenty
    terms = (
        (0.30, contacts.area / 0.30),  # a third of the pad's face is as good as all of it
        (0.25, 1 - np.arccos(np.clip(contacts.alignment, -1, 1)) / np.arctan(settings.friction)),
        (0.25, 1 - lever / (0.6 * model.d_max)),
        (0.10, 1 - contacts.offset / (settings.friction * np.maximum(contacts.width, 0.01))),
        (0.10, spare),
    )
    return np.exp(sum(weight * np.log(np.clip(term, 0.02, 1.0)) for weight, term in terms))


def _replicate(found: GraspSet, model: PartModel) -> GraspSet:
    """Apply every element of the part's symmetry group to every grasp."""
    to_centre = make_transform(translation=-model.centre)
    back = make_transform(translation=model.centre)
    turns = [back @ make_transform(R) @ to_centre for R in model.symmetry.elements(_SYMMETRY_STEPS)]
    repeated = found.take(np.tile(np.arange(len(found)), len(turns)))
    T = np.concatenate([turn @ found.T_part_grasp for turn in turns])
    return GraspSet(T_part_grasp=T, **{f.name: getattr(repeated, f.name) for f in fields(GraspSet)[1:]})


def _spread(found: GraspSet, limit: int, shallow: NDArray[np.int64]) -> NDArray[np.int64]:
    """Choose at most ``limit`` indices, best first, spread evenly over approach, jaw direction and place.

    The best of every cell (about 15 degrees of approach, 30 of the jaw, 10 mm) is kept. Where that is too many, each
    approach contributes the best grasp of each of its places and widths, then the second best of each, and so on. A
    part with good grasps on its rim thus keeps those on its hub, which may be the only ones that neighbours leave free.
    Grasps off the floor, by ``BroadSides.shallow``, have cells of their own and count as better than all others here.
    """
    order = np.lexsort((-found.quality, shallow == 0))
    T = found.T_part_grasp[order]
    approach = np.argmax(T[:, :3, 2] @ _fibonacci_sphere(180).T, axis=1)
    jaw = np.argmax(np.abs(T[:, :3, 1] @ _fibonacci_sphere(90).T), axis=1)  # a jaw has no sign
    place = np.floor(T[:, :3, 3] / 0.010).astype(np.int64)
    _, first = np.unique(np.column_stack([approach, jaw, place, shallow[order]]), axis=0, return_index=True)
    first = np.sort(first)
    region = np.floor(T[:, :3, 3] / 0.025).astype(np.int64)
    width = np.floor(found.width[order] / 0.010).astype(np.int64)
    _, site = np.unique(np.column_stack([approach, region, width])[first], axis=0, return_inverse=True)
    kept = order[np.sort(first[np.lexsort((_ranks(approach[first]), _ranks(site)))[:limit]])]
    best_first: NDArray[np.int64] = kept[np.argsort(-found.quality[kept], kind="stable")]
    return best_first


def _ranks(groups: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the (N,) number of earlier entries of the same group."""
    by_group = np.argsort(groups, kind="stable")
    starts = np.searchsorted(groups[by_group], groups[by_group])
    ranks = np.empty(len(groups), dtype=np.int64)
    ranks[by_group] = np.arange(len(groups)) - starts
    return ranks


def _fibonacci_sphere(count: int) -> Floats:
    """Return (count, 3) directions spread evenly over the sphere."""
    i = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    radius = np.sqrt(1 - z * z)
    return np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z])
