"""Poses of a part in frames of a real camera: read, perceived, written as JSON, printed and drawn."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
