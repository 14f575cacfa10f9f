"""Assessment of a part in the cell: what is measured, what it means, and what to do about it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
