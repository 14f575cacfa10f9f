"""Noise models: bins that the learned perceiver is observed on, fits to its errors, and a check of the fits."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
