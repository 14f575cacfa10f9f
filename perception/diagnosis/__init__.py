"""Reasons instead of silence: what a frame shows of the bin, and the likely cause where parts are not found."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
