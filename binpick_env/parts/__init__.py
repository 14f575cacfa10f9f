"""The parts: a catalogue drawn in code, and any mesh file through the same door."""

from binpick_env.parts.catalogue import CATALOGUE
from binpick_env.parts.part import Part, load_part
from binpick_env.parts.pieces import PieceSettings, convex_pieces
from binpick_env.parts.symmetry import SymmetrySettings, detect_symmetry, symmetry_error
from binpick_env.parts.unit import Unit

__all__ = [
    "CATALOGUE",
    "Part",
    "PieceSettings",
    "SymmetrySettings",
    "Unit",
    "convex_pieces",
    "detect_symmetry",
    "load_part",
    "symmetry_error",
]
