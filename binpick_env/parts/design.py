"""A part before the simulation has it: as drawn, as generated, or as read from a file."""

from dataclasses import dataclass

import trimesh

from perception.part import Symmetry

Solids = tuple[trimesh.Trimesh, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Design:
    """A part as drawn, or as read from a file.

    Attributes:
        name: Name of the part.
        mesh: Watertight mesh in the part frame [m].
        pieces: Convex bodies in the part frame [m]; those of a catalogue part are the mesh with its bores filled.
        density: Density of the material [kg/m^3].
        symmetry: Symmetry group about the origin, declared or detected.
    """

    name: str
    mesh: trimesh.Trimesh
    pieces: Solids
    density: float
    symmetry: Symmetry
