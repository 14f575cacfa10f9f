"""Picking: the scripted picker, the execution of an attempt, and one bin from the drop to its end."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
