"""Evaluation of segmentation on synthetic scenes: records, summaries, tables, reports and ablations."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
