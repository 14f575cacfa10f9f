"""Jobs that are killed, that share a folder, or whose disk is full, and what they leave behind."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
