"""Training of grasp selectors: MaskablePPO, and a contextual bandit on logged attempts."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
