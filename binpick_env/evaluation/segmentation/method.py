"""Segmentation methods behind one interface, so that one evaluation compares all of them."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.choices import SegmentationKind
from perception.boundary import BoundaryCloud
from perception.geometry import Floats
from perception.instance import Instance, instances_of
from perception.runtime.job_files import local_file
from perception.runtime.last_result import LastResult
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
    """Method that turns boundary points into instances.

    Attributes:
        kind: "network" for a trained network, or "euclidean" for the baseline: components of points close together.
        weights: ``.safetensors`` file of the network.
        grouping: "ours" groups all points in the network's embedding (``group_points``). "merging" applies SGPN's
            GroupMerging to one random subset; every other point takes the label of its nearest neighbour in the subset.
        mask: Whether points farther apart than d_max are prevented from sharing a group.
        threshold: Largest embedding distance within a group; the default of the grouping unless given.
        radius: Largest distance of linked points under "euclidean" [m].
        min_points: Smallest number of points of a component under "euclidean".
        subset: Number of points that a network over point sets processes at once, and that "merging" groups.
        seed: Seed of the random subsets.
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
    def grouping_distance(self) -> float:
        """Distance below which points share a group, either of embeddings or, for "euclidean", a radius [m]."""
        if self.kind == "euclidean":
            return self.radius
        default = GroupMergingConfig if self.grouping == "merging" else GroupingConfig
        return default().threshold if self.threshold is None else self.threshold

    def with_grouping_distance(self, distance: float) -> "MethodConfig":
        """Return the same method with another :attr:`grouping_distance`."""
        return replace(self, radius=distance) if self.kind == "euclidean" else replace(self, threshold=distance)

    def settings(self) -> dict[str, Any]:
        """Return the settings as a dict; weights are represented by their SHA-256, whatever their path."""
        return {**asdict(self), "weights": self.digest()}

    def digest(self) -> str | None:
        """Return the SHA-256 of the weights; None without weights."""
        return None if self.weights is None else hashlib.sha256(local_file(self.weights).read_bytes()).hexdigest()


class Segmenter:
    """Segmentation method with its network loaded."""

    def __init__(self, config: MethodConfig) -> None:
        """Load the weights, if the method has any.

        Raises:
            WeightsError: The weights file does not hold a complete network.
        """
        self.config = config
        self.warm = False  # whether it has segmented a frame: the first one takes longer
        self._predictor: SegmentationPredictor | None = None
        self._distance: Distance = "l2"
        if config.kind == "network" and config.weights is not None:
            self._distance = trained_distance(load_record(config.weights))
            self._predictor = SegmentationPredictor.from_file(config.weights, self._predictor_config(config.threshold))

    def segment(
        self, boundary: BoundaryCloud, surface: Surface, d_max: float, shape: Floats | None = None
    ) -> list[Instance]:
        """Return the instances by descending score; see :meth:`SegmentationPredictor.predict`."""
        if self._predictor is not None and self.config.grouping == "ours":
            return self._predictor.predict(boundary, surface, d_max, shape)
        return self.segment_at((self.config.grouping_distance,), boundary, surface, d_max, shape)[0]

    def segment_at(
        self,
        distances: Sequence[float],
        boundary: BoundaryCloud,
        surface: Surface,
        d_max: float,
        shape: Floats | None = None,
    ) -> list[list[Instance]]:
        """Return the instances for each :attr:`MethodConfig.grouping_distance`; the network runs once."""
        config, points = self.config, boundary.points_cam
        if len(boundary) == 0:
            return [[] for _ in distances]
        if self._predictor is None:
            return [euclidean_components(points, radius, config.min_points) for radius in distances]
        if config.grouping == "ours":
            predictions = self._predictor.describe(boundary, surface, d_max, shape)
            return [self._grouped(predictions, boundary, d_max, threshold) for threshold in distances]
        chosen = np.random.default_rng(config.seed).permutation(len(boundary))[: config.subset]
        predictions = self._predictor.describe(boundary.only(chosen), surface, d_max, shape)
        return [self._merged(predictions, boundary, chosen, d_max, threshold) for threshold in distances]

    def _grouped(
        self, predictions: PointPredictions, boundary: BoundaryCloud, d_max: float, threshold: float
    ) -> list[Instance]:
        grouping = self._predictor_config(threshold).grouping
        groups = group_points(predictions.embedding, predictions.confidence, boundary.points_cam, d_max, grouping)
        return instances_of(groups.labels, groups.scores)

    def _merged(
        self,
        predictions: PointPredictions,
        boundary: BoundaryCloud,
        chosen: NDArray[np.int64],
        d_max: float,
        threshold: float,
    ) -> list[Instance]:
        """Group the predictions of the ``chosen`` points, and propagate the labels to all points."""
        merging = GroupMergingConfig(threshold=threshold, distance=self._distance)
        points = boundary.points_cam
        limit = d_max if self.config.mask else None
        groups = merge_groups(predictions.embedding, predictions.confidence, points[chosen], merging, d_max=limit)
        return instances_of(propagate_labels(points, chosen, groups.labels), groups.scores)

    def _predictor_config(self, threshold: float | None) -> PredictorConfig:
        grouping = GroupingConfig(distance=self._distance, d_max=self.config.mask)
        if threshold is not None:
            grouping = replace(grouping, threshold=threshold)
        return PredictorConfig(grouping=grouping, subset=self.config.subset, seed=self.config.seed)


def segmenter(config: MethodConfig) -> Segmenter:
    """Return the loaded method; it is cached until settings or weights change."""
    return _loaded(config, config.digest())


@LastResult
def _loaded(config: MethodConfig, digest: str | None) -> Segmenter:  # noqa: ARG001 - part of the key
    return Segmenter(config)


def trained_distance(record: dict[str, Any]) -> Distance:
    """Return the embedding distance that a network was trained with, by the record of its weights."""
    training = record.get("training") or {}
    return "scaled_square" if training.get("pairs", {}).get("distance") == "scaled_square" else "l2"
