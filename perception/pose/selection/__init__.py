"""Pose selection: solids that collide, the greedy choice among poses, and segments explained by poses."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
