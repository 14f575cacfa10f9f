"""Frames of real cameras: depth images, point clouds and calibrations of many formats, read into a :class:`Frame`."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
