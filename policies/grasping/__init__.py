"""Grasps of a parallel jaw: the gripper, antipodal grasps on a part, and which of them are clear of a scene."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
