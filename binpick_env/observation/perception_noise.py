"""Statistics of the learned perceiver's errors, fitted to its results on many bins, from which errors can be drawn.

Statistics that depend on how much of a part is visible are kept per interval ("bin") of its true visible fraction.
Shapes: V bins, Q quantiles.
"""

import json
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.parts.label import part_label

SHIPPED = Path(__file__).resolve().parent / "noise"
NOISE_VERSION = 1


class NoiseError(ValueError):
    """There is no noise model for a part, or a file does not hold one of this version."""


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

    def draw(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Draw a translation [m], a rotation [rad] and a score, independently of each other."""
        tables = (self.translation, self.rotation, self.score)
        draws = rng.random(3)
        return tuple(_quantile(table, at) for table, at in zip(tables, draws, strict=True))  # type: ignore[return-value]


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


@dataclass(frozen=True, kw_only=True)
class PerceptionNoise:
    """Noise model of a perceiver: replaces it in training, which then costs physics only.

    Errors are drawn independently for each part and each frame. A real perceiver's are slightly correlated.

    Attributes:
        bins: (V,) statistics by rising visible fraction, the last interval ending at 1.
        wrong: Errors and scores of the wrong poses, such as a flipped part or one fitted to a neighbour's points.
        false_rate: Mean number of candidates per frame that belong to no part, or are a part's second.
        false_score: (Q,) quantiles of the false candidates' scores.
        provenance: Command, seed, bins and commit of the fit.
    """

    bins: tuple[NoiseBin, ...]
    wrong: Spread
    false_rate: float = 0.0
    false_score: tuple[float, ...] = (0.0, 1.0)
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        ends = [each.high for each in self.bins]
        if not ends or ends != sorted(set(ends)) or ends[-1] != 1.0:
            raise ValueError(f"bins must rise and end at 1, got {ends}")
        if not self.false_rate >= 0:
            raise ValueError(f"false_rate must not be negative, got {self.false_rate}")

    def bin_of(self, visible_fraction: float) -> NoiseBin:
        """Return the statistics of parts with a true visible fraction."""
        ends = [each.high for each in self.bins]
        return self.bins[min(int(np.searchsorted(ends, visible_fraction)), len(ends) - 1)]

    def draw_false_score(self, rng: np.random.Generator) -> float:
        """Draw the score of a false candidate."""
        return _quantile(self.false_score, rng.random())

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "PerceptionNoise":
        """Build a noise model from the values of its JSON file.

        Raises:
            NoiseError: The values are not a noise model of this version.
        """
        try:
            if values["version"] != NOISE_VERSION:
                raise NoiseError(f"the noise model is of version {values['version']}, this code reads {NOISE_VERSION}")
            bins = tuple(NoiseBin(**{**each, "spread": _spread(each["spread"])}) for each in values["bins"])
            return cls(
                bins=bins,
                wrong=_spread(values["wrong"]),
                false_rate=values["false_rate"],
                false_score=tuple(values["false_score"]),
                provenance=values["provenance"],
            )
        except (KeyError, TypeError) as error:
            raise NoiseError(f"the noise model is incomplete ({error!r})") from error

    @classmethod
    def load(cls, path: Path) -> "PerceptionNoise":
        """Read a noise model from its JSON file.

        Raises:
            NoiseError: The file is missing or does not hold a model of this version.
        """
        try:
            values = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise NoiseError(f"{path} holds no noise model ({error})") from error
        return cls.from_plain(values)

    @classmethod
    def for_part(cls, part: str, sensor: str = "good") -> "PerceptionNoise":
        """Return the shipped noise model of a catalogue part under a sensor preset.

        Args:
            part: Name of the part, or path of its file, of which no model is shipped.
            sensor: Name of the sensor preset.

        Raises:
            NoiseError: There is none; the text names the command that makes one.
        """
        path = SHIPPED / f"{part_label(part)}_{sensor}.json"
        if not path.exists():
            known = ", ".join(sorted(each.stem for each in SHIPPED.glob("*.json"))) or "none"
            raise NoiseError(
                f"there is no noise model of {part!r} under sensor {sensor!r} (there are: {known}); "
                f"fit one with binpick fit-noise --part {shlex.quote(part)} --sensor {sensor}"
            )
        return cls.load(path)


def _quantile(table: tuple[float, ...], at: float) -> float:
    """Return the value at a quantile in [0, 1] of a (Q,) table of evenly spaced quantiles."""
    return float(np.interp(at, np.linspace(0.0, 1.0, len(table)), np.asarray(table)))


def _spread(values: dict[str, Any]) -> Spread:
    tables: dict[str, tuple[float, ...]] = {name: tuple(table) for name, table in values.items()}
    return Spread(**tables)
