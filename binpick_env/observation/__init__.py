"""From a labelled capture to pose candidates: perceivers that read pixels, and oracles."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
