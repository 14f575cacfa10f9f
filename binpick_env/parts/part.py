"""One door for every part: a catalogue name, or a mesh file."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh

from binpick_env.parts.catalogue import CATALOGUE, design
from binpick_env.parts.density import FILE_DENSITY, check_density
from binpick_env.parts.mesh_file import read_mesh
from binpick_env.parts.pieces import convex_pieces
from binpick_env.parts.symmetry import detect_symmetry
from binpick_env.parts.unit import Unit, check_unit
from perception.geometry import Floats
from perception.part import PartModel, Symmetry

SymmetryChoice = Symmetry | Literal["detect", "none"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """A part as the simulation needs it. Shared between callers, so its meshes are immutable: change a copy.

    Attributes:
        model: What perception may know: mesh, ``d_max``, symmetry, centre.
        pieces: Convex collision meshes, part frame [m].
        density: [kg/m^3].
        mass: [kg].
        inertia: (3, 3) about ``model.centre`` in part axes [kg m^2].
        source: Catalogue name, or the file's absolute path.
        unit: Of the file's coordinates, given or guessed; "m" for a catalogue part.
    """

    model: PartModel
    pieces: tuple[trimesh.Trimesh, ...]
    density: float
    mass: float
    inertia: Floats
    source: str
    unit: str = "m"


def load_part(
    name_or_path: str | Path,
    *,
    unit: Unit | None = None,
    symmetry: SymmetryChoice = "detect",
    density: float | None = None,
) -> Part:
    """Load a part by its catalogue name or from an STL, OBJ or PLY file.

    The part frame keeps the axes of the drawing; its origin is moved to the volume's centroid.

    Args:
        name_or_path: One of ``CATALOGUE``, or a path.
        unit: Of a file's coordinates. None takes metres or millimetres, whichever is plausible for a part.
        symmetry: "detect" measures a file's group (a catalogue part's is declared); "none" is the trivial group.
        density: [kg/m^3]; None takes the catalogue's, or 2700 (aluminium) for a file.

    Returns:
        The part; catalogue parts are built once per process.

    Raises:
        ValueError: For an unknown name, a file that is no watertight mesh of a part's size, or a bad argument.
        FileNotFoundError: If the path does not exist.

    Note:
        A catalogue part takes 0.1 s. A file takes seconds at first, for its pieces; they are cached on disk.
    """
    name = str(name_or_path)
    if unit is not None:
        check_unit(unit)
    if density is not None:
        check_density(density)
    if not (isinstance(symmetry, Symmetry) or symmetry in ("detect", "none")):
        raise ValueError(f"symmetry must be 'detect', 'none' or a Symmetry, got {symmetry!r}")
    if name in CATALOGUE:
        if unit is not None:
            raise ValueError(f"unit belongs to mesh files; {name!r} is a catalogue part, in metres; got unit={unit!r}")
        return _catalogue_part(name, symmetry, density)
    path = Path(name_or_path)
    if not path.suffix and not path.exists():
        raise ValueError(
            f"part must be one of {', '.join(CATALOGUE)}, or a path to a .stl, .obj or .ply file, got {name!r}"
        )
    return _file_part(path, unit, symmetry, density or FILE_DENSITY)


def resolve_part(part: str | Path | Part, unit: Unit | None, symmetry: SymmetryChoice, density: float | None) -> Part:
    """Return a part given as such, or load it; ``unit``, ``symmetry`` and ``density`` as in :func:`load_part`.

    Raises:
        ValueError: An option is given beside a part that is loaded already, or the part cannot be loaded.
    """
    if not isinstance(part, Part):
        return load_part(part, unit=unit, symmetry=symmetry, density=density)
    given = {"unit": unit is not None, "symmetry": symmetry != "detect", "density": density is not None}
    twice = [name for name, is_given in given.items() if is_given]
    if twice:
        raise ValueError(f"{', '.join(twice)} cannot be given beside a loaded part: give it to load_part")
    return part


@lru_cache(maxsize=32)
def _catalogue_part(name: str, symmetry: SymmetryChoice, density: float | None) -> Part:
    drawn = design(name)
    group = drawn.symmetry if symmetry == "detect" else symmetry
    return _assemble(name, drawn.mesh, drawn.pieces, group, density or drawn.density, source=name)


def _file_part(path: Path, unit: Unit | None, symmetry: SymmetryChoice, density: float) -> Part:
    mesh = read_mesh(path, unit)
    unit_read = str(mesh.metadata["unit"])
    mesh.apply_translation(-mesh.center_mass)
    group = detect_symmetry(mesh) if symmetry == "detect" else symmetry
    return _assemble(path.stem, mesh, convex_pieces(mesh), group, density, source=str(path.resolve()), unit=unit_read)


def _assemble(
    name: str,
    mesh: trimesh.Trimesh,
    pieces: tuple[trimesh.Trimesh, ...],
    symmetry: SymmetryChoice,
    density: float,
    *,
    source: str,
    unit: str = "m",
) -> Part:
    group = symmetry if isinstance(symmetry, Symmetry) else Symmetry()
    for shared in (mesh, *pieces):
        shared.mutable = False
    return Part(
        model=PartModel.from_mesh(name, mesh, group),
        pieces=pieces,
        density=density,
        mass=float(mesh.volume * density),
        inertia=np.asarray(mesh.moment_inertia, dtype=np.float64) * density,
        source=source,
        unit=unit,
    )
