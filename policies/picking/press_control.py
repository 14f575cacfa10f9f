"""Pressing while moving: how much lower than planned the fingertips go, so that they keep a force."""

import numpy as np

from policies.grasping.pushes import PushSettings

_SMOOTHING = 0.5  # weight of a new reading; a stiff contact bounces from one control period to the next


class PressControl:
    """Lowers closed fingertips while they press too little on a part, and raises them while they press too much.

    The arm follows positions, and gives way by a millimetre for about 5 N. A way planned in the height at which the
    part was first felt would lose it: parts are not level, tilt, and lie lower once they have been moved.
    """

    def __init__(self, settings: PushSettings) -> None:
        """Begin at the planned height.

        Args:
            settings: Force to keep, and how fast and how far the height may change for it.
        """
        self._settings = settings
        self._force: float | None = None
        self.lower = 0.0

    def felt(self, force: float) -> float:
        """Take the contact force [N] after a control period.

        Returns:
            How much lower than planned the fingertips go next [m]; negative is higher.
        """
        settings = self._settings
        self._force = force if self._force is None else (1 - _SMOOTHING) * self._force + _SMOOTHING * force
        change = settings.compliance * (settings.drag_force - self._force)
        change = float(np.clip(change, -settings.largest_change, settings.largest_change))
        self.lower = float(np.clip(self.lower + change, -settings.higher, settings.lower))
        return self.lower
