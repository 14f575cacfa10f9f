"""Evaluation of pose estimation on synthetic scenes: records, summaries, tables, reports, ablations, calibration."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
