"""The cell and its physics: robot, bin and tray, dropping parts, judging deliveries, pictures of the cell."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
