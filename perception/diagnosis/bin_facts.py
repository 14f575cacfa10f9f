"""How the bin that was measured in a frame differs from the believed one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.bin import BinFit
from perception.frame import Workspace
from perception.geometry import Floats


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
        opening: Measured length and width of the opening [m], None where its edges were not seen; None without both.
        size_given: Inner length, width and height that were given without a place [m]; None if they were measured.
        height_assumed: Stated height that the place of the floor rests on, which was not seen [m]; None if it was.
        height_seen: Height of the rim above the lowest level in the bin, be it floor or flat parts [m]; None without
            rim or level.
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
    opening: tuple[float | None, ...] | None = None
    size_given: tuple[float, ...] | None = None
    height_assumed: float | None = None
    height_seen: float | None = None

    @classmethod
    def of(cls, fit: BinFit, believed: Workspace | None, size_given: Floats | None = None) -> "BinFacts":
        """Return the facts of a fit.

        Args:
            fit: The bin as the frame shows it.
            believed: The bin as it was believed to be; None if its place was not known.
            size_given: (3,) inner size [m] that was given without a place; None if it was measured.
        """
        given = None if size_given is None else tuple(size_given.tolist())
        edges = np.isfinite(fit.opening)
        opening = tuple(float(v) if there else None for v, there in zip(fit.opening, edges, strict=True))
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
                opening=opening if edges.any() else None,
                size_given=given,
            )
        distance, angle = (None, None) if believed is None else fit.offset_from(believed)
        size = fit.inner_size if believed is None else None
        stated = size_given if believed is None else believed.inner_size
        assumed = None if stated is None or "floor" in fit.seen else float(stated[2])
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
            opening=opening if edges.any() else None,
            size_given=given,
            height_assumed=assumed,
            height_seen=None if np.isnan(fit.height) else fit.height,
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
        elif self.size_given is not None:
            opening = (
                "its opening was not seen as a whole"
                if self.opening is None
                else f"an opening of {_mm(self.opening)} mm"
            )
            where = f": {opening}, {_mm(self.size_given)} mm inside as given"
        elif self.inner_size is not None:
            where = f": {_mm(self.inner_size)} mm inside"
        only = "" if walls else ", height and tilt only"
        return (
            f"the bin was measured by {', '.join(seen)}{where} (standard deviations "
            f"{1000 * self.translation_std:.1f} mm, {np.degrees(self.rotation_std):.2f} degrees{only}){self._unseen()}"
        )

    def _unseen(self) -> str:
        """Return what is said of a floor that was not seen."""
        if self.height_assumed is None:
            return ""
        unseen = f"; its floor was not seen, so that it lies where the stated height of {_mm([self.height_assumed])} mm"
        if self.height_seen is None:
            return f"{unseen} puts it"
        return f"{unseen} puts it: flat parts cover it, or it is {_mm([self.height_seen])} mm below the rim"


def _mm(size: Sequence[float | None]) -> str:
    return " x ".join("?" if value is None else f"{1000 * value:.0f}" for value in size)
