"""Average precision of segmentations, errors and recognition rates of poses, and their intervals."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
