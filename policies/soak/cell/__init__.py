"""Soak tests of the environments: hostile actions, random decisions, and the rules that each step must keep."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
