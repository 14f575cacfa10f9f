"""Rooms of S3DIS: the raw folder tree, prepared files and blocks of points."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
