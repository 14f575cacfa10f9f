"""Generated parts: families of industrial shapes with random parameters, split into training and held-out ones."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
