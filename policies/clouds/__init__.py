"""Clouds of boundary points alone: segmented, scored where they are labelled, and shown on a page."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
