"""Evaluations of segmentation and pose estimation on synthetic scenes, and the fit of the perceiver's noise model."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
