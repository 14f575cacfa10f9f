"""Grasp selection: grasp candidates, their features, the selection environment, and selectors with their evaluation."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
