"""Boundary points, instance segmentation and 6D poses from the arrays of a depth camera.

``Pipeline.for_part(part, workspace).perceive(frame)`` runs all three. The package knows no simulator.
"""

import lazy_loader as lazy

from perception.runtime.kernel_cache import use_writable_kernel_cache

use_writable_kernel_cache()  # before any kernel is declared

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
