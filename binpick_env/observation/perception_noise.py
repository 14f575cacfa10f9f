"""Statistics of the learned perceiver's errors, fitted to its results on many bins, from which errors can be drawn.

Statistics that depend on how much of a part is visible are kept per interval ("bin") of its true visible fraction.
Shapes: V bins, Q quantiles.
"""

import json
import logging
import shlex
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from binpick_env.config import CameraConfig
from binpick_env.observation.noise_statistics import NoiseBin, Spread, quantile
from binpick_env.observation.part_class import CLASSES, PartClass, part_class, size_px
from binpick_env.parts.label import part_label
from binpick_env.parts.part import Part, resolve_part
from perception.part import PartModel
from perception.shape import same_shape, shape_signature

_log = logging.getLogger(__name__)
SHIPPED = Path(__file__).resolve().parent / "noise"
GENERAL = "general"  # name of the model for every part
NOISE_VERSION = 1
_Model = TypeVar("_Model")


class NoiseError(ValueError):
    """There is no noise model for a part, or a file does not hold one of this version."""


@dataclass(frozen=True, kw_only=True)
class DrawnErrors:
    """Errors of one candidate, drawn from a noise model.

    Attributes:
        wrong: Whether the pose is one of the wrong ones.
        translation: Distance of the part's centre from its true position, in the model's unit of length.
        rotation: Angle to the true rotation, modulo symmetry [rad].
        score: Confidence in [0, 1].
        visible_fraction: Estimated visible fraction.
        fill: Number of visible boundary points over P, that of a whole part.
    """

    wrong: bool
    translation: float
    rotation: float
    score: float
    visible_fraction: float
    fill: float


@dataclass(frozen=True, kw_only=True)
class PerceptionNoise:
    """Noise model of a perceiver: replaces it in training, which then costs physics only.

    Errors are drawn independently for each part and each frame. A real perceiver's are slightly correlated. Lengths are
    in metres; those of a class of `GeneralNoise` are shares of ``d_max``.

    Attributes:
        bins: (V,) statistics by rising visible fraction, the last interval ending at 1.
        wrong: Errors and scores of the wrong poses, such as a flipped part or one fitted to a neighbour's points.
        false_rate: Mean number of candidates per frame that belong to no part, or are a part's second.
        false_score: (Q,) quantiles of the false candidates' scores.
        provenance: Command, seed, bins and commit of the fit; ``shape`` identifies the part.
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

    def draw(self, visible_fraction: float, rng: np.random.Generator) -> DrawnErrors | None:
        """Draw the errors of the candidate of a part; None if it has no candidate.

        Args:
            visible_fraction: True visible fraction of the part.
            rng: Source of all random numbers.
        """
        noise = self.bin_of(visible_fraction)
        if rng.random() >= noise.offered:
            return None
        wrong = bool(rng.random() < noise.wrong)
        translation, rotation, score = (self.wrong if wrong else noise.spread).draw(rng)
        visible = visible_fraction + noise.visible_bias + noise.visible_sigma * rng.normal()
        return DrawnErrors(
            wrong=wrong,
            translation=translation,
            rotation=rotation,
            score=score,
            visible_fraction=float(np.clip(visible, 0.0, 1.0)),
            fill=visible_fraction * noise.fill_ratio,
        )

    def draw_false_score(self, rng: np.random.Generator) -> float:
        """Draw the score of a false candidate."""
        return quantile(self.false_score, rng.random())

    def scaled(self, factor: float) -> "PerceptionNoise":
        """Return the model with all lengths multiplied by ``factor``."""

        def times(spread: Spread) -> Spread:
            return replace(spread, translation=tuple(factor * each for each in spread.translation))

        bins = tuple(replace(each, spread=times(each.spread)) for each in self.bins)
        return replace(self, bins=bins, wrong=times(self.wrong))

    def plain(self) -> dict[str, Any]:
        """Return the values of the JSON file."""
        return {"version": NOISE_VERSION, **asdict(self)}

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "PerceptionNoise":
        """Build a noise model from the values of its JSON file.

        Raises:
            NoiseError: The values are not a noise model of this version.
        """
        try:
            _require_version(values)
            return cls(
                bins=tuple(NoiseBin.from_plain(each) for each in values["bins"]),
                wrong=Spread.from_plain(values["wrong"]),
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
        return _loaded(path, cls.from_plain)

    @classmethod
    def for_part(
        cls, part: str | Path | Part, sensor: str = "good", camera: CameraConfig | None = None
    ) -> "PerceptionNoise":
        """Return the shipped noise model of a part under a sensor preset, or else what that for every part says of it.

        A part is recognised by its shape. Files of older versions, which do not record the shape, are matched by name.

        Args:
            part: Loaded part, or its name or file.
            sensor: Preset of the depth sensor's noise.
            camera: Camera, which determines the size of the part in the image; the standard one unless given.

        Raises:
            NoiseError: There is neither; the text names the commands that make them.
            ValueError: There is no such part.
        """
        wanted = resolve_part(part, None, "detect", None)
        own = _file_of(wanted, sensor)
        if own is not None:
            _log.info("errors of poses: noise model %s, which was fitted to this part", own.name)
            return cls.load(own)
        path = general_file(sensor)
        if not path.exists():
            known = ", ".join(sorted(each.stem for each in SHIPPED.glob("*.json"))) or "none"
            raise NoiseError(
                f"there is no noise model of {wanted.source!r} under sensor {sensor!r}, and none for every part (there "
                f"are: {known}); fit one with binpick fit-noise --part {shlex.quote(wanted.source)} --sensor {sensor}, "
                f"or one for every part with binpick fit-noise --part generated --sensor {sensor}"
            )
        return GeneralNoise.load(path).for_part(wanted.model, camera or CameraConfig())


@dataclass(frozen=True, kw_only=True)
class GeneralNoise:
    """Noise model for every part: one model for each class of parts, its lengths as shares of ``d_max``.

    Attributes:
        classes: Models by size in the image and shape; a class that the fit saw too little of has pooled statistics.
        provenance: Command, seed, parts, network and commit of the fit.
    """

    classes: Mapping[PartClass, PerceptionNoise]
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        missing = [each for each in CLASSES if each not in self.classes]
        if missing:
            raise ValueError(f"a model for every part must have all {len(CLASSES)} classes, got none for {missing}")

    def for_part(self, part: PartModel, camera: CameraConfig) -> PerceptionNoise:
        """Return the model of a part, in metres.

        Args:
            part: Part whose shape and ``d_max`` are measured.
            camera: Camera, which determines the size of the part in the image.
        """
        own = part_class(shape_signature(part), size_px(part.d_max, camera))
        parts = len(self.classes[own].provenance.get("parts", []))
        _log.info(
            "errors of poses: noise model for every part, as of %s %s parts (fitted to %d of these, and to all parts "
            "where they are too few)", own.size, own.shape, parts
        )  # fmt: skip
        return self.classes[own].scaled(part.d_max)

    def plain(self) -> dict[str, Any]:
        """Return the values of the JSON file."""
        classes = [{**key._asdict(), **self.classes[key].plain()} for key in CLASSES]
        return {"version": NOISE_VERSION, "unit": "d_max", "classes": classes, "provenance": self.provenance}

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "GeneralNoise":
        """Build a model from the values of its JSON file.

        Raises:
            NoiseError: The values are not a model for every part, of this version.
        """
        try:
            _require_version(values)
            models = {
                PartClass(one["size"], one["shape"]): PerceptionNoise.from_plain(one) for one in values["classes"]
            }
            return cls(classes=models, provenance=values["provenance"])
        except (KeyError, TypeError) as error:
            raise NoiseError(f"the noise model for every part is incomplete ({error!r})") from error

    @classmethod
    def load(cls, path: Path) -> "GeneralNoise":
        """Read a model from its JSON file.

        Raises:
            NoiseError: The file is missing or does not hold a model for every part, of this version.
        """
        return _loaded(path, cls.from_plain)


def general_file(sensor: str) -> Path:
    """Return the path of the shipped model for every part under a sensor preset."""
    return SHIPPED / f"{GENERAL}_{sensor}.json"


def _file_of(part: Part, sensor: str) -> Path | None:
    """Return the file of the model that was fitted to a part; None if there is none."""
    signature, label = shape_signature(part.model), part_label(part.source)
    for path in sorted(SHIPPED.glob(f"*_{sensor}.json")):
        if path == general_file(sensor):
            continue
        shape = _read(path).get("provenance", {}).get("shape")
        if path.stem == f"{label}_{sensor}" if shape is None else same_shape(shape, signature):
            return path
    return None


def _read(path: Path) -> dict[str, Any]:
    try:
        values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise NoiseError(f"{path} holds no noise model ({error})") from error
    return values


def _loaded(path: Path, build: Callable[[dict[str, Any]], _Model]) -> _Model:
    values = _read(path)
    try:
        return build(values)
    except ValueError as error:
        raise NoiseError(f"{path} cannot be used: {error}") from error


def _require_version(values: dict[str, Any]) -> None:
    if values["version"] != NOISE_VERSION:
        raise NoiseError(f"the noise model is of version {values['version']}, this code reads {NOISE_VERSION}")
