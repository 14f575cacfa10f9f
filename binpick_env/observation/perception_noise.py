"""How the learned perceiver errs, as numbers: fitted once to what it made of many bins, and drawn from ever after.

What depends on how much of a part is seen is kept by bins of its true visible fraction. V bins, Q quantiles.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

SHIPPED = Path(__file__).resolve().parent / "noise"
NOISE_VERSION = 1


class NoiseError(ValueError):
    """There is no noise model for a part, or a file does not hold one of this version."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """How large the errors of some poses are, and how sure the perceiver is of them: Q quantiles from 0 to 1.

    Attributes:
        translation: Distance of the part's centre from its true place [m].
        rotation: Angle to the true attitude, modulo symmetry [rad].
        score: Confidence.
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
        """Return a translation [m], a rotation [rad] and a score; the three are independent."""
        tables = (self.translation, self.rotation, self.score)
        draws = rng.random(3)
        return tuple(_quantile(table, at) for table, at in zip(tables, draws, strict=True))  # type: ignore[return-value]


@dataclass(frozen=True, kw_only=True)
class NoiseBin:
    """What happens to parts of which about so much is seen.

    Attributes:
        high: Upper end of their visible fractions; the bin begins where the one before ends.
        count: Parts that it was fitted to.
        offered: Share of them that a candidate was offered of.
        wrong: Share of these candidates whose pose is wrong: beyond a tenth of d_max or 5 deg, as everywhere.
        spread: Of the right ones.
        visible_bias: Mean of estimated minus true visible fraction.
        visible_sigma: Standard deviation of that.
        fill_ratio: Mean of visible boundary points over P, as a multiple of the true visible fraction.
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
    """A stand-in for a perceiver's errors, for training that should cost physics only.

    Errors of one look are independent of each other and of the look before, which a real perceiver's are not quite.

    Attributes:
        bins: V of them by rising visible fraction, the last up to 1.
        wrong: Errors and scores of the wrong poses: a part turned round, or a neighbour's points taken for its own.
        false_rate: Candidates of a frame, on average, that are no part's, or a part's second.
        false_score: Q quantiles of their scores.
        provenance: Command, seed, bins, commit.
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
        """Return the bin of a part of which so much is seen."""
        ends = [each.high for each in self.bins]
        return self.bins[min(int(np.searchsorted(ends, visible_fraction)), len(ends) - 1)]

    def draw_false_score(self, rng: np.random.Generator) -> float:
        """Return the score of a false candidate."""
        return _quantile(self.false_score, rng.random())

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "PerceptionNoise":
        """Rebuild a model from JSON's values.

        Raises:
            NoiseError: They are not a model of this version.
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
            raise NoiseError(f"there is no whole noise model ({error!r})") from error

    @classmethod
    def load(cls, path: Path) -> "PerceptionNoise":
        """Read a model's JSON.

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
        """Return the shipped model of a catalogue part under a sensor.

        Raises:
            NoiseError: There is none; the text names the command that makes it.
        """
        path = SHIPPED / f"{part}_{sensor}.json"
        if not path.exists():
            known = ", ".join(sorted(each.stem for each in SHIPPED.glob("*.json"))) or "none"
            raise NoiseError(
                f"there is no noise model of {part!r} under sensor {sensor!r} (there are: {known}); "
                f"fit one with scripts/fit_noise.py --part {part} --sensor {sensor}"
            )
        return cls.load(path)


def _quantile(table: tuple[float, ...], at: float) -> float:
    return float(np.interp(at, np.linspace(0.0, 1.0, len(table)), np.asarray(table)))


def _spread(values: dict[str, Any]) -> Spread:
    tables: dict[str, tuple[float, ...]] = {name: tuple(table) for name, table in values.items()}
    return Spread(**tables)
