"""Evaluation of a picker: bins picked, compared with the ground truth, recorded and summarised."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
