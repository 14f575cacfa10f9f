"""Networks that map points to an embedding, a confidence and semantic logits: mathematics only."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
