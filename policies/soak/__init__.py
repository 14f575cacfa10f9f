"""Soak tests: long runs of the environments, malformed inputs and killed jobs, each judged by fixed rules."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
