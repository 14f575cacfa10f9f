"""The parts: a catalogue drawn in code, and any mesh file through the same door."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
