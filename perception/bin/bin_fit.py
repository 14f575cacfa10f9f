"""The result of measuring a bin in a frame."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from perception.frame import Workspace
from perception.geometry import Floats, invert_transform, require_rigid, require_shape, rotation_angle

BinSurface = Literal["floor", "rim", "wall_x+", "wall_x-", "wall_y+", "wall_y-"]


@dataclass(frozen=True, eq=False, kw_only=True)
class BinFit:
    """A bin as a frame shows it.

    A wall counts as seen where the inner edge of its rim or its inner face was measured. Without any wall, as on a
    table, only the height and the tilt of the floor are measured; position and turn on it are those started from.

    Attributes:
        T_world_bin: (4, 4) pose of the bin; None if it was not measured and there was none to start from. An unreliable
            fit has the pose that it started from.
        inner_size: (3,) inner length, width and height of the bin [m]; None if it is not known, as that of a table.
        opening: (2,) measured length and width of the opening between the inner edges of the rim [m]; NaN where the
            edges of only one side, or of none, were seen. An unreliable fit may have that of another bin.
        translation_std: Standard deviation of the bin's measured position along its least certain axis [m].
        rotation_std: Standard deviation of its measured orientation about its least certain axis [rad].
        points: Number of points that support each surface; 0 for one that was not seen.
        residual: Root mean square distance of these points from the fitted surfaces [m]; NaN without any.
        reason: Why the fit is unreliable; None for a reliable fit.
        height: Measured height of the rim above the lowest level in the bin [m], which is the floor if that is among
            the surfaces ``seen``, and may be flat parts otherwise; NaN without rim or level. That of an unreliable fit
            is the height that its rim suggests, by the pose it started from or by what is measured below it, or NaN.
    """

    T_world_bin: Floats | None
    inner_size: Floats | None
    opening: Floats
    translation_std: float
    rotation_std: float
    points: Mapping[BinSurface, int]
    residual: float
    reason: str | None = None
    height: float = float("nan")

    def __post_init__(self) -> None:
        if self.T_world_bin is not None:
            require_rigid("T_world_bin", self.T_world_bin)
        elif self.reason is None:
            raise ValueError("a reliable fit must have a pose, got None")
        require_shape("opening", self.opening, (2,))
        unknown = [name for name in self.points if name not in get_args(BinSurface)]
        if unknown:
            raise ValueError(f"points must be of {', '.join(get_args(BinSurface))}, got {', '.join(unknown)}")

    @property
    def reliable(self) -> bool:
        """Whether the pose was measured."""
        return self.reason is None

    @property
    def seen(self) -> tuple[BinSurface, ...]:
        """Surfaces that were seen."""
        return tuple(name for name, count in self.points.items() if count > 0)

    @property
    def walls_seen(self) -> bool:
        """Whether position and turn on the floor were measured, not only its height and tilt."""
        return any(name.startswith("wall") for name in self.seen)

    def workspace(self, inner_size: Floats | None = None) -> Workspace:
        """Return the bin.

        Args:
            inner_size: (3,) inner length, width and height [m], in place of those of the fit.

        Raises:
            ValueError: There is no pose, or no size.
        """
        size = self.inner_size if inner_size is None else inner_size
        if self.T_world_bin is None or size is None:
            missing = "pose" if self.T_world_bin is None else "inner_size"
            raise ValueError(f"the fit has no {missing}: {self.reason or 'no walls were seen; state inner_size'}")
        return Workspace(T_world_bin=self.T_world_bin, inner_size=size)

    def offset_from(self, workspace: Workspace) -> tuple[float, float]:
        """Return how far the bin is from where it is believed to be: distance [m] and angle [rad].

        Args:
            workspace: The bin as it is believed to be.

        Raises:
            ValueError: There is no pose.
        """
        if self.T_world_bin is None:
            raise ValueError(f"the fit has no pose: {self.reason}")
        T = invert_transform(workspace.T_world_bin) @ self.T_world_bin
        return float(np.linalg.norm(T[:3, 3])), float(rotation_angle(T[:3, :3]))
