"""6D poses of parts from segments of boundary points, by PPF-MEAM."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
