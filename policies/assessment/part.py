"""What a part is: unit, size, mass, symmetry, bodies, repairs."""

from dataclasses import dataclass

from binpick_env.parts.file_facts import UnitOrigin
from binpick_env.parts.part import Part
from binpick_env.parts.symmetry import NearSymmetry, SymmetrySettings, near_symmetry
from perception.part import Symmetry
from perception.size import METRES, PLAUSIBLE


@dataclass(frozen=True, kw_only=True)
class PartFacts:
    """What a part is.

    Attributes:
        name: Catalogue name or file stem.
        source: Name of a catalogue part or a generated part, or absolute path of the file.
        unit: Unit of the file's coordinates; "m" for a part without a file.
        unit_origin: Whether the unit was given, is named by the file, or was guessed; None for a part without a file.
        other_units: ``d_max`` [m] in other units that would make a part of plausible size, by unit; empty unless the
            unit was guessed.
        d_max: Largest distance between two points of the part [m].
        size: Length, width and height of the smallest box around the part [m], falling.
        mass: Mass [kg].
        density: Density of the material [kg/m^3].
        volume: Volume [m^3].
        symmetry: Symmetry group in words.
        near_symmetry: The rotation that comes nearest to a symmetry; None where none is near, or none was looked for.
        bodies: Number of bodies in the file, which are one body now.
        repairs: What was changed in the mesh, one sentence for each.
        faces: Number of faces of the mesh.
    """

    name: str
    source: str
    unit: str
    unit_origin: UnitOrigin | None
    other_units: dict[str, float]
    d_max: float
    size: tuple[float, float, float]
    mass: float
    density: float
    volume: float
    symmetry: str
    near_symmetry: NearSymmetry | None
    bodies: int
    repairs: tuple[str, ...]
    faces: int


def part_facts(part: Part, symmetry: SymmetrySettings | None = None) -> PartFacts:
    """Return what a part is.

    Args:
        part: Loaded part.
        symmetry: How the symmetry of a file was detected, so that a near one is looked for; None looks for none.
    """
    model, file = part.model, part.file
    mesh = model.mesh
    long, middle, short = sorted((float(side) for side in mesh.bounding_box_oriented.primitive.extents), reverse=True)
    near = None if file is None or symmetry is None else near_symmetry(mesh, model.symmetry, symmetry)
    return PartFacts(
        name=model.name,
        source=part.source,
        unit=part.unit,
        unit_origin=None if file is None else file.unit_origin,
        other_units=other_units(model.d_max, part.unit) if file is not None and file.unit_origin == "guessed" else {},
        d_max=model.d_max,
        size=(long, middle, short),
        mass=part.mass,
        density=part.density,
        volume=float(mesh.volume),
        symmetry=symmetry_words(model.symmetry),
        near_symmetry=near,
        bodies=1 if file is None else file.bodies,
        repairs=() if file is None else file.repairs,
        faces=len(mesh.faces),
    )


def other_units(d_max: float, unit: str) -> dict[str, float]:
    """Return ``d_max`` [m] in the other units that would make a part of plausible size, by unit.

    Args:
        d_max: Largest distance between two points of the part, as it was read [m].
        unit: Unit that the coordinates were read in.
    """
    coordinates = d_max / METRES[unit]
    sizes = {other: coordinates * scale for other, scale in METRES.items() if other != unit}
    return {other: size for other, size in sizes.items() if PLAUSIBLE[0] <= size <= PLAUSIBLE[1]}


def symmetry_words(symmetry: Symmetry) -> str:
    """Return a symmetry group in words."""
    if symmetry.sphere:
        return "ball: every rotation"
    if symmetry.axis is not None:
        return "solid of revolution" + (", the same upside down" if len(symmetry.rotations) > 1 else "")
    order = len(symmetry.rotations)
    return "none" if order == 1 else f"order {order}: {order} rotations map it onto itself"
