"""Ways to segment a frame's boundary points behind one door, so that the same evaluation judges all of them."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.choices import SegmentationKind
from perception.boundary import BoundaryCloud
from perception.instance import Instance, instances_of
from perception.segmentation.grouping.euclidean import euclidean_components
from perception.segmentation.grouping.group_merging import GroupMergingConfig, merge_groups
from perception.segmentation.grouping.similarity import GroupingConfig, group_points, propagate_labels
from perception.segmentation.networks.distance import Distance
from perception.segmentation.predictor import PointPredictions, PredictorConfig, SegmentationPredictor
from perception.segmentation.surface import Surface
from perception.segmentation.weights import load_record

Grouping = Literal["ours", "merging"]


@dataclass(frozen=True, kw_only=True)
class MethodConfig:
    """How boundary points become instances.

    Attributes:
        kind: A trained network, or the floor: components of points that lie close together.
        weights: The network's ``.safetensors`` file.
        grouping: Of the network's embedding: ``group_points`` over all points, or SGPN's GroupMerging on one random
            subset, whose labels every other point takes from its nearest neighbour in it.
        mask: Whether points farther apart than d_max are kept from being one group.
        threshold: Embedding distance of one group; the grouping's own default unless given.
        radius: Distance of linked points under ``euclidean`` [m].
        min_points: Smallest component under ``euclidean``.
        subset: Points that a network over point sets sees at once, and that ``merging`` groups.
        seed: Of the subsets.
    """

    kind: SegmentationKind = "network"
    weights: Path | None = None
    grouping: Grouping = "ours"
    mask: bool = True
    threshold: float | None = None
    radius: float = 0.002
    min_points: int = 30
    subset: int = 4096
    seed: int = 0

    def __post_init__(self) -> None:
        for name, choices in (("kind", get_args(SegmentationKind)), ("grouping", get_args(Grouping))):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}")
        if self.kind == "network" and self.weights is None:
            raise ValueError("kind 'network' needs weights, got None")
        for name in ("radius", "min_points", "subset"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if self.threshold is not None and not self.threshold > 0:
            raise ValueError(f"threshold must be positive, got {self.threshold}")

    @property
    def setting(self) -> float:
        """The threshold, or the radius of ``euclidean``: what has to be chosen."""
        if self.kind == "euclidean":
            return self.radius
        default = GroupMergingConfig if self.grouping == "merging" else GroupingConfig
        return default().threshold if self.threshold is None else self.threshold

    def at(self, setting: float) -> "MethodConfig":
        """Return the same method with another :attr:`setting`."""
        return replace(self, radius=setting) if self.kind == "euclidean" else replace(self, threshold=setting)

    def settings(self) -> dict[str, Any]:
        """Return the settings as plain values; weights count by their content, wherever they lie."""
        return {**asdict(self), "weights": self.digest()}

    def digest(self) -> str | None:
        """Return the weights' SHA-256; None without any."""
        return None if self.weights is None else hashlib.sha256(self.weights.read_bytes()).hexdigest()


class Segmenter:
    """A method with its network loaded."""

    def __init__(self, config: MethodConfig) -> None:
        """Load the weights, if the method has any.

        Raises:
            WeightsError: They do not hold a whole network.
        """
        self.config = config
        self.warm = False  # whether it has segmented anything: the first time is slower
        self._predictor: SegmentationPredictor | None = None
        self._distance: Distance = "l2"
        if config.kind == "network" and config.weights is not None:
            self._distance = trained_distance(load_record(config.weights))
            self._predictor = SegmentationPredictor.from_file(config.weights, self._predictor_config(config.threshold))

    def segment(self, boundary: BoundaryCloud, surface: Surface, d_max: float) -> list[Instance]:
        """Return the instances, best first; see :meth:`SegmentationPredictor.predict`."""
        if self._predictor is not None and self.config.grouping == "ours":
            return self._predictor.predict(boundary, surface, d_max)
        return self.segment_at((self.config.distance,), boundary, surface, d_max)[0]

    def segment_at(
        self, settings: Sequence[float], boundary: BoundaryCloud, surface: Surface, d_max: float
    ) -> list[list[Instance]]:
        """Return the instances at each of ``settings`` (see :attr:`MethodConfig.distance`); the network runs once."""
        config, points = self.config, boundary.points_cam
        if len(boundary) == 0:
            return [[] for _ in settings]
        if self._predictor is None:
            return [euclidean_components(points, radius, config.min_points) for radius in settings]
        if config.grouping == "ours":
            said = self._predictor.describe(boundary, surface, d_max)
            return [self._grouped(said, boundary, d_max, threshold) for threshold in settings]
        chosen = np.random.default_rng(config.seed).permutation(len(boundary))[: config.subset]
        said = self._predictor.describe(boundary.only(chosen), surface, d_max)
        return [self._merged(said, boundary, chosen, d_max, threshold) for threshold in settings]

    def _grouped(self, said: PointPredictions, boundary: BoundaryCloud, d_max: float, t: float) -> list[Instance]:
        grouping = self._predictor_config(t).grouping
        groups = group_points(said.embedding, said.confidence, boundary.points_cam, d_max, grouping)
        return instances_of(groups.labels, groups.scores)

    def _merged(
        self, said: PointPredictions, boundary: BoundaryCloud, chosen: NDArray[np.int64], d_max: float, t: float
    ) -> list[Instance]:
        merging = GroupMergingConfig(threshold=t, distance=self._distance)
        points = boundary.points_cam
        reach = d_max if self.config.mask else None
        groups = merge_groups(said.embedding, said.confidence, points[chosen], merging, d_max=reach)
        return instances_of(propagate_labels(points, chosen, groups.labels), groups.scores)

    def _predictor_config(self, threshold: float | None) -> PredictorConfig:
        grouping = GroupingConfig(distance=self._distance, d_max=self.config.mask)
        if threshold is not None:
            grouping = replace(grouping, threshold=threshold)
        return PredictorConfig(grouping=grouping, subset=self.config.subset, seed=self.config.seed)


def segmenter(config: MethodConfig) -> Segmenter:
    """Return the method, kept from call to call as long as settings and weights stay what they are."""
    return _loaded(config, config.digest())


@lru_cache(maxsize=1)
def _loaded(config: MethodConfig, digest: str | None) -> Segmenter:  # noqa: ARG001 - part of the key
    return Segmenter(config)


def trained_distance(record: dict[str, Any]) -> Distance:
    """Return the embedding distance that weights were trained with, by the JSON beside them."""
    training = record.get("training") or {}
    return "scaled_square" if training.get("pairs", {}).get("distance") == "scaled_square" else "l2"
