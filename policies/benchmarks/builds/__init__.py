"""Two builds of the project, compared in speed, memory and results on the same inputs."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
