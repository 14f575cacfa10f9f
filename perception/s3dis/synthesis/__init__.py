"""Synthetic rooms in the format of S3DIS, for tests and dry runs without the data set."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
