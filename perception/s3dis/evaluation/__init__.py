"""Table 1 of the paper: trainings, scores, and the published rows."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
