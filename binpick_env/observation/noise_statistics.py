"""Statistics of errors of perception: quantiles of errors, and rates at a visible fraction. Q quantiles."""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Distribution of the errors and scores of poses, as Q evenly spaced quantiles from 0 to 1.

    Attributes:
        translation: (Q,) distances of the part's centre from its true position [m].
        rotation: (Q,) angles to the true rotation, modulo symmetry [rad].
        score: (Q,) confidences in [0, 1].
    """

    translation: tuple[float, ...]
    rotation: tuple[float, ...]
    score: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("translation", "rotation", "score"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if len(values) < 2 or not np.all(np.diff(values) >= 0) or not values[0] >= 0:
                raise ValueError(f"{name} must hold two or more rising quantiles from 0 on, got {getattr(self, name)}")
        if self.score[-1] > 1:
            raise ValueError(f"score must not exceed 1, got {self.score[-1]}")

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "Spread":
        """Build a distribution from its JSON values."""
        tables: dict[str, tuple[float, ...]] = {name: tuple(table) for name, table in values.items()}
        return cls(**tables)

    def draw(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Draw a translation [m], a rotation [rad] and a score, independently of each other."""
        tables = (self.translation, self.rotation, self.score)
        draws = rng.random(3)
        return tuple(quantile(table, at) for table, at in zip(tables, draws, strict=True))  # type: ignore[return-value]


@dataclass(frozen=True, kw_only=True)
class NoiseBin:
    """Statistics of the parts whose true visible fraction lies in one interval.

    Attributes:
        high: Upper end of the interval, which begins where the one before ends.
        count: Number of parts that the statistics were fitted to.
        offered: Share of these parts for which a candidate was offered.
        wrong: Share of the candidates whose pose is wrong: off by more than a tenth of d_max or 5 deg.
        spread: Errors and scores of the candidates whose pose is right.
        visible_bias: Mean of the estimated minus the true visible fraction.
        visible_sigma: Standard deviation of the estimated minus the true visible fraction.
        fill_ratio: Mean of visible boundary points over P, divided by the true visible fraction.
    """

    high: float
    count: int
    offered: float
    wrong: float
    spread: Spread
    visible_bias: float = 0.0
    visible_sigma: float = 0.0
    fill_ratio: float = 1.0

    def __post_init__(self) -> None:
        for name in ("high", "offered", "wrong"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        for name in ("count", "visible_sigma", "fill_ratio"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "NoiseBin":
        """Build statistics from their JSON values."""
        return cls(**{**values, "spread": Spread.from_plain(values["spread"])})


def quantile(table: tuple[float, ...], at: float) -> float:
    """Return the value at a quantile in [0, 1] of a (Q,) table of evenly spaced quantiles."""
    return float(np.interp(at, np.linspace(0.0, 1.0, len(table)), np.asarray(table)))
