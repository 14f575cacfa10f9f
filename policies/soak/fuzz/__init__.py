"""Malformed inputs, drawn from grammars, each given to the product in a child process with limits."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
