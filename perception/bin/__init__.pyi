from .bin_fit import BinFit as BinFit
from .bin_fit import BinSurface as BinSurface
from .choices import Trust as Trust
from .choices import check_trust as check_trust
from .finding import find_bin as find_bin
from .trust import reconcile as reconcile
