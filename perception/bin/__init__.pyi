from .bin_fit import BinFit as BinFit
from .bin_fit import BinSurface as BinSurface
from .finding import find_bin as find_bin
