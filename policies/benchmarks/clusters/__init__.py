"""What a Ray cluster costs, and what one of any size would give."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
