"""The S3DIS benchmark (Table 1 of the paper): rooms, training, prediction and scores."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
