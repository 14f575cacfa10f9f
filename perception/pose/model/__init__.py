"""A part's models: edges, pair features, surface samples and near-symmetries."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
