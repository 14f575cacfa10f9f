"""Labelled synthetic scenes for training and evaluation, and statistics of their clutter."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
