"""Generated parts: parameters, size and material drawn from a seed that family and index determine."""

import hashlib

import numpy as np

from binpick_env.parts.design import Design
from binpick_env.parts.families.drawing import Drawing
from binpick_env.parts.families.names import GeneratedName
from binpick_env.parts.families.registry import FAMILIES
from binpick_env.parts.families.solid import as_trimesh, without_slivers
from perception.part import diameter

VERSION = 1  # version of the generator; raise it when the same names give other parts
LEAST_WALL = 0.001  # thinnest wall that is generated [m]
LEAST_SHARE = 0.02  # thinnest wall, as a share of d_max
ATTEMPTS = 50  # number of drawings of a part, of which the first is taken whose walls are thick enough
DENSITIES = (2700.0, 7850.0, 1400.0)  # aluminium, steel and rigid plastic [kg/m^3]


def generated_design(name: GeneratedName) -> Design:
    """Draw a part: shape, then size, then material.

    The size is drawn log-uniformly. A part whose thinnest wall would be under 1 mm is drawn larger than its size says,
    or again where the range does not allow that.

    Args:
        name: Family, index and range of sizes.

    Raises:
        ValueError: No drawing of ``ATTEMPTS`` has walls of 1 mm within the range of sizes.

    Note:
        Deterministic. A part takes 0.01 to 0.2 s.
    """
    drawing, scale, density = _drawn(name)
    mesh = as_trimesh(without_slivers(drawing.solid.mesh).scale((scale, scale, scale)))
    pieces = tuple(as_trimesh(piece.hull().scale((scale, scale, scale))) for piece in drawing.solid.pieces)
    origin = mesh.center_mass.copy()
    for solid in (mesh, *pieces):
        solid.apply_translation(-origin)
    return Design(name=str(name), mesh=mesh, pieces=pieces, density=density, symmetry=drawing.symmetry)


def drawing_of(name: GeneratedName) -> Drawing:
    """Return the drawing that a part is made from, before it is scaled."""
    return _drawn(name)[0]


def _drawn(name: GeneratedName) -> tuple[Drawing, float, float]:
    """Return drawing, scale [m per unit of the drawing] and density."""
    rng = _generator(name)
    low, high = name.d_max_range
    wanted = low * (high / low) ** rng.random()
    density = float(rng.choice(DENSITIES))
    for _ in range(ATTEMPTS):
        drawing = FAMILIES[name.family](rng)
        size = diameter(np.asarray(drawing.solid.mesh.to_mesh64().vert_properties)[:, :3])
        d_max = max(wanted, LEAST_WALL * size / drawing.wall)
        if drawing.wall >= LEAST_SHARE * size and d_max <= high:
            return drawing, d_max / size, density
    raise ValueError(
        f"no {name.family} of d_max {low * 1000:g} to {high * 1000:g} mm has walls of {LEAST_WALL * 1000:g} mm; "
        "take a range of larger parts"
    )


def _generator(name: GeneratedName) -> np.random.Generator:
    family = int.from_bytes(hashlib.sha256(name.family.encode()).digest()[:8], "big")
    return np.random.default_rng([family, name.index])
