"""Segmentation of boundary points into the visible parts: scenes, networks, training and prediction."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
