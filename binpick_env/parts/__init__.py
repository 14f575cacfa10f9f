"""Parts: a catalogue drawn in code, and mesh files; unit, symmetry and convex pieces of their meshes."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
