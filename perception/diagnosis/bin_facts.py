"""How the bin that was measured in a frame differs from the believed one."""

from dataclasses import dataclass

import numpy as np

from perception.bin import BinFit
from perception.frame import Workspace


@dataclass(frozen=True, kw_only=True)
class BinFacts:
    """Facts of the measurement of a bin.

    Attributes:
        measured: Whether the bin was measured.
        reason: Why it was not; None if it was.
        distance: Distance of the measured bin from the believed one [m]; None if it was not measured, or without one.
        angle: Angle between the two [rad]; None likewise.
        translation_std: Standard deviation of the measured position along its least certain axis [m]; None likewise.
        rotation_std: Standard deviation of the measured orientation about its least certain axis [rad]; None likewise.
        seen: Surfaces that were seen.
        residual: Root mean square distance of the supporting points from these surfaces [m]; None likewise.
        inner_size: Inner length, width and height [m], where nothing was believed; None otherwise, and for a table.
    """

    measured: bool
    reason: str | None
    distance: float | None
    angle: float | None
    translation_std: float | None
    rotation_std: float | None
    seen: tuple[str, ...]
    residual: float | None
    inner_size: tuple[float, ...] | None = None

    @classmethod
    def of(cls, fit: BinFit, believed: Workspace | None) -> "BinFacts":
        """Return the facts of a fit.

        Args:
            fit: The bin as the frame shows it.
            believed: The bin as it was believed to be; None if its place was not known.
        """
        if not fit.reliable:
            return cls(
                measured=False,
                reason=fit.reason,
                distance=None,
                angle=None,
                translation_std=None,
                rotation_std=None,
                seen=(),
                residual=None,
            )
        distance, angle = (None, None) if believed is None else fit.offset_from(believed)
        size = fit.inner_size if believed is None else None
        return cls(
            measured=True,
            reason=None,
            distance=distance,
            angle=angle,
            translation_std=fit.translation_std,
            rotation_std=fit.rotation_std,
            seen=fit.seen,
            residual=fit.residual,
            inner_size=None if size is None else tuple(size.tolist()),
        )

    def __str__(self) -> str:
        if not self.measured or self.translation_std is None or self.rotation_std is None:
            return f"the bin was not measured: {self.reason}"
        walls = sum(name.startswith("wall") for name in self.seen)
        seen = [name for name in self.seen if not name.startswith("wall")]
        seen += [f"{walls} wall{'' if walls == 1 else 's'}"] if walls else []
        where = ""
        if self.distance is not None and self.angle is not None:
            where = (
                f": {1000 * self.distance:.1f} mm and {np.degrees(self.angle):.2f} degrees from where it was believed "
                "to be"
            )
        elif self.inner_size is not None:
            where = f": {' x '.join(f'{1000 * value:.0f}' for value in self.inner_size)} mm inside"
        only = "" if walls else ", height and tilt only"
        return (
            f"the bin was measured by {', '.join(seen)}{where} (standard deviations "
            f"{1000 * self.translation_std:.1f} mm, {np.degrees(self.rotation_std):.2f} degrees{only})"
        )
