"""Parts as the simulation needs them, loaded by catalogue name, generated, or read from a mesh file."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh

from binpick_env.parts.catalogue import CATALOGUE, design
from binpick_env.parts.density import FILE_DENSITY, check_density
from binpick_env.parts.design import Design
from binpick_env.parts.families.generator import generated_design
from binpick_env.parts.families.names import GeneratedName, is_generated, parse_name
from binpick_env.parts.file_facts import FileFacts
from binpick_env.parts.mesh_file import D_MAX, read_mesh
from binpick_env.parts.mesh_formats import SUFFIXES
from binpick_env.parts.pieces import convex_pieces
from binpick_env.parts.symmetry import SymmetrySettings, detect_symmetry
from binpick_env.parts.unit import Unit, check_unit
from perception.geometry import Floats
from perception.part import PartModel, Symmetry
from perception.runtime.job_files import local_file, resolved_path

SymmetryChoice = Symmetry | Literal["detect", "none"]
_NO_SYMMETRY = Symmetry()  # a single one, by which the same file is found again among the loaded ones


@dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """A part as the simulation needs it. It is shared between callers, so its meshes are immutable: change a copy.

    Attributes:
        model: Mesh, ``d_max``, symmetry and centre, which perception may know.
        pieces: Convex collision meshes, part frame [m].
        density: Density of the material [kg/m^3].
        mass: Mass [kg].
        inertia: (3, 3) inertia tensor about ``model.centre``, part axes [kg m^2].
        source: Name of a catalogue part or a generated part, or absolute path of the file.
        unit: Unit of the file's coordinates, given or guessed; "m" for a part without a file.
        file: How the file was read; None for a part without a file.
        sides: Sides of the least bounding box, ascending [m]; empty for a part without a file.
    """

    model: PartModel
    pieces: tuple[trimesh.Trimesh, ...]
    density: float
    mass: float
    inertia: Floats
    source: str
    unit: str = "m"
    file: FileFacts | None = None
    sides: tuple[float, ...] = ()


def load_part(
    name_or_path: str | Path,
    *,
    unit: Unit | None = None,
    symmetry: SymmetryChoice = "detect",
    density: float | None = None,
    symmetry_tolerance: float | None = None,
) -> Part:
    """Load a part by its catalogue name, generate one, or read a mesh or STEP file.

    The part frame keeps the axes of the drawing; its origin is moved to the volume's centroid.

    Args:
        name_or_path: One of ``CATALOGUE``, the name of a generated part such as ``generated:hex_bolt:17``, or a path to
            a mesh file.
        unit: Unit of a file's coordinates. None takes metres or millimetres, whichever is plausible for a part.
        symmetry: "detect" measures the group of a file's mesh (that of any other part is declared); "none" is the
            trivial group.
        density: Density of the material [kg/m^3]; None takes the part's own, or 2700 (aluminium) for a file.
        symmetry_tolerance: Largest deviation of a file's surface from itself under a symmetry [m]; None takes 0.5 % of
            its ``d_max``.

    Returns:
        The part. Catalogue parts, the last 32 generated ones and the last 8 files are built once per process; a file
        that has changed is read again.

    Raises:
        ValueError: The name is unknown, the file is no watertight mesh of a part's size, or an argument is invalid.
        FileNotFoundError: The path does not exist.

    Note:
        A catalogue part or a generated part takes 0.1 s. A file takes seconds the first time, for its pieces, which are
        cached on disk.
    """
    if not isinstance(name_or_path, str | Path):
        raise ValueError(f"part must be a name, a path to a file or a loaded Part, got {name_or_path!r}")
    name = str(name_or_path)
    if unit is not None:
        check_unit(unit)
    if density is not None:
        check_density(density)
    if not (isinstance(symmetry, Symmetry) or symmetry in ("detect", "none")):
        raise ValueError(f"symmetry must be 'detect', 'none' or a Symmetry, got {symmetry!r}")
    settings = SymmetrySettings(metres=symmetry_tolerance)
    if symmetry_tolerance is not None and (symmetry != "detect" or name in CATALOGUE or is_generated(name)):
        raise ValueError(
            "symmetry_tolerance belongs to mesh files whose symmetry is detected, "
            f"got {symmetry_tolerance} for {name!r} with symmetry={symmetry!r}"
        )
    if name in CATALOGUE:
        if unit is not None:
            raise ValueError(f"unit belongs to mesh files; {name!r} is a catalogue part, in metres; got unit={unit!r}")
        return _catalogue_part(name, symmetry, density)
    if is_generated(name):
        if unit is not None:
            raise ValueError(f"unit belongs to mesh files; {name!r} is a generated part, in metres; got unit={unit!r}")
        return _generated_part(parse_name(name), symmetry, density)
    path, source = local_file(Path(name_or_path)), resolved_path(Path(name_or_path))
    if not path.suffix and not path.exists():
        raise ValueError(
            f"part must be one of {', '.join(CATALOGUE)}, generated:FAMILY:INDEX, or a path to a file "
            f"({', '.join(SUFFIXES)}), got {name!r}"
        )
    group = settings if symmetry == "detect" else _group(symmetry)
    version = source, path.read_bytes() if path.is_file() else b""
    return _file_part(path, source, unit, group, density or FILE_DENSITY, hash(version))


def generate_part(family: str, index: int, d_max_range: tuple[float, float] = D_MAX) -> Part:
    """Return a part of a family with random parameters; the same arguments give the same part.

    Args:
        family: Name of the family, one of ``binpick_env.parts.families.FAMILIES``.
        index: Number of the part within its family, from 0 on.
        d_max_range: Range from which ``d_max`` is drawn log-uniformly [m], of whole millimetres.

    Raises:
        ValueError: There is no such family, or no part of it has walls of 1 mm at such a size.
    """
    low, high = d_max_range
    return load_part(str(GeneratedName(family=family, index=index, d_max_range=(low, high))))


def resolve_part(
    part: str | Path | Part,
    unit: Unit | None,
    symmetry: SymmetryChoice,
    density: float | None,
    symmetry_tolerance: float | None = None,
) -> Part:
    """Return a part given as such, or load it with the options of :func:`load_part`.

    Raises:
        ValueError: An option is given beside a part that is loaded already, or the part cannot be loaded.
    """
    if not isinstance(part, Part):
        return load_part(part, unit=unit, symmetry=symmetry, density=density, symmetry_tolerance=symmetry_tolerance)
    given = {"unit": unit is not None, "symmetry": symmetry != "detect", "density": density is not None}
    given["symmetry_tolerance"] = symmetry_tolerance is not None
    twice = [name for name, is_given in given.items() if is_given]
    if twice:
        raise ValueError(f"{', '.join(twice)} cannot be given beside a loaded part: give it to load_part")
    return part


@lru_cache(maxsize=32)
def _catalogue_part(name: str, symmetry: SymmetryChoice, density: float | None) -> Part:
    drawn = design(name)
    group = drawn.symmetry if symmetry == "detect" else _group(symmetry)
    return _assemble(replace(drawn, symmetry=group, density=density or drawn.density), source=name)


@lru_cache(maxsize=32)
def _generated_part(name: GeneratedName, symmetry: SymmetryChoice, density: float | None) -> Part:
    drawn = generated_design(name)
    group = drawn.symmetry if symmetry == "detect" else _group(symmetry)
    return _assemble(replace(drawn, symmetry=group, density=density or drawn.density), source=str(name))


@lru_cache(maxsize=8)
def _file_part(
    path: Path,
    source: str,
    unit: Unit | None,
    symmetry: Symmetry | SymmetrySettings,
    density: float,
    version: int,  # noqa: ARG001 - a hash of the file's place and content: a changed file is another part
) -> Part:
    mesh = read_mesh(path, unit)
    facts: FileFacts = mesh.metadata["facts"]
    x, y, z = (float(value) for value in mesh.center_mass)
    mesh.apply_translation((-x, -y, -z))
    group = symmetry if isinstance(symmetry, Symmetry) else detect_symmetry(mesh, symmetry)
    drawn = Design(name=path.stem, mesh=mesh, pieces=convex_pieces(mesh), density=density, symmetry=group)
    part = _assemble(drawn, source=source)
    return replace(part, unit=facts.unit, file=replace(facts, origin=(x, y, z)), sides=mesh.metadata["sides"])


def _group(symmetry: SymmetryChoice) -> Symmetry:
    return symmetry if isinstance(symmetry, Symmetry) else _NO_SYMMETRY


def _assemble(drawn: Design, *, source: str) -> Part:
    for shared in (drawn.mesh, *drawn.pieces):
        shared.mutable = False
    return Part(
        model=PartModel.from_mesh(drawn.name, drawn.mesh, drawn.symmetry),
        pieces=drawn.pieces,
        density=drawn.density,
        mass=float(drawn.mesh.volume * drawn.density),
        inertia=np.asarray(drawn.mesh.moment_inertia, dtype=np.float64) * drawn.density,
        source=source,
    )
