from .catalogue import CATALOGUE as CATALOGUE
from .part import Part as Part
from .part import load_part as load_part
from .pieces import PieceSettings as PieceSettings
from .pieces import convex_pieces as convex_pieces
from .symmetry import SymmetrySettings as SymmetrySettings
from .symmetry import detect_symmetry as detect_symmetry
from .symmetry import symmetry_error as symmetry_error
