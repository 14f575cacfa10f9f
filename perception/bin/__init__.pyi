from .bin_fit import BinFit as BinFit
from .bin_fit import BinSurface as BinSurface
from .finding import find_bin as find_bin
from .trust import Trust as Trust
from .trust import check_trust as check_trust
from .trust import reconcile as reconcile
