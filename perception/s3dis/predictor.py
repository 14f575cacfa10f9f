"""Prediction of the objects of a room: the network on every block, grouping, merging of blocks."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from perception.instance import Instance
from perception.runtime.job_files import local_file
from perception.s3dis.data.blocks import BlockConfig, BlockSample, RoomFrame, cover_room, point_features
from perception.s3dis.data.categories import CATEGORIES
from perception.s3dis.data.dataset import sees_colour
from perception.s3dis.data.room import Room
from perception.s3dis.merging import BlockMerger, MergeConfig, SampleGroups
from perception.segmentation.grouping.group_merging import GroupMergingConfig, merge_groups
from perception.segmentation.grouping.similarity import GroupingConfig, Groups, group_points
from perception.segmentation.networks.output import PointOutputs
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.training.losses import PairLossConfig
from perception.segmentation.weights import WeightsError, load_network, load_record

PointNetwork = Callable[[torch.Tensor], PointOutputs]
LEAST_OF_4096 = 50  # smallest number of points of a group in a sample of 4096 (released code)


@dataclass(frozen=True, kw_only=True)
class RoomPredictorConfig:
    """Settings of the prediction with a trained network.

    Attributes:
        grouping: Grouping of the points of a sample: ours, or SGPN's GroupMerging by category.
        blocks: Division of a room into blocks; samples are as large as in training.
        merging: Merging of the blocks.
        min_sizes: (13,) smallest number of points of an object of each category; no limit unless given.
        colour: Whether the network sees colour.
        batch: Number of samples that go through the network at once.
    """

    grouping: GroupingConfig | GroupMergingConfig = field(default_factory=lambda: sample_grouping(4096))
    blocks: BlockConfig = field(default_factory=BlockConfig)
    merging: MergeConfig = field(default_factory=MergeConfig)
    min_sizes: tuple[float, ...] | None = None
    colour: bool = True
    batch: int = 4

    def __post_init__(self) -> None:
        if self.batch < 1:
            raise ValueError(f"batch must be at least 1, got {self.batch}")
        if self.min_sizes is not None and len(self.min_sizes) != len(CATEGORIES):
            raise ValueError(f"min_sizes must be {len(CATEGORIES)} numbers, got {len(self.min_sizes)}")


def sample_grouping(points: int, pairs: PairLossConfig | None = None, threshold: float | None = None) -> GroupingConfig:
    """Return the grouping of a sample for a network trained with ``pairs``.

    Args:
        points: Number of points of a sample. The smallest group is in proportion to that of SGPN's code.
        pairs: Pair loss of the training; the defaults unless given.
        threshold: Embedding distance under which points are similar; the loss's own unless given.
    """
    pairs = pairs or PairLossConfig()
    return GroupingConfig(
        threshold=pairs.threshold if threshold is None else threshold,
        distance=pairs.distance,
        d_max=False,
        min_points=max(1, round(points * LEAST_OF_4096 / 4096)),
    )


@dataclass(frozen=True, eq=False)
class SampleOutputs:
    """Outputs of the network for the P points of a sample.

    Attributes:
        sample: Points of the sample, of which the first ``sample.distinct`` are distinct.
        embedding: (P, F) float32 embedding.
        confidence: (P,) float32 confidence in [0, 1].
        categories: (P,) int64 most probable category.
    """

    sample: BlockSample
    embedding: NDArray[np.float32]
    confidence: NDArray[np.float32]
    categories: NDArray[np.int64]


def describe_room(
    network: PointNetwork,
    room: Room,
    rng: np.random.Generator,
    config: RoomPredictorConfig,
    device: torch.device | str = "cpu",
) -> Iterator[SampleOutputs]:
    """Yield the outputs of a network for samples that cover every point of a room, block by block.

    Args:
        network: Trained network.
        room: Room to describe.
        rng: Source of the division of blocks into samples.
        config: Settings of the prediction.
        device: Device of the computation.
    """
    frame = RoomFrame.of(room.xyz)
    coming = cover_room(room.xyz, config.blocks, rng)
    while samples := list(islice(coming, config.batch)):
        points = np.stack([point_features(room, frame, sample, config.colour) for sample in samples])
        with torch.inference_mode():
            outputs = network(torch.from_numpy(points).to(device))
            category_BN = outputs.semantics_BNS.argmax(dim=2)
            arrays = [
                a.cpu().numpy() for a in (outputs.embedding_BNF.float(), outputs.confidence_BN.float(), category_BN)
            ]
        for k, sample in enumerate(samples):
            yield SampleOutputs(sample, *(array[k] for array in arrays))


def group_sample(
    outputs: SampleOutputs, xyz: NDArray[np.float32], grouping: GroupingConfig | GroupMergingConfig
) -> SampleGroups:
    """Return the groups of the distinct points of a sample.

    Args:
        outputs: Outputs of the network for the sample.
        xyz: (N, 3) points of the room [m].
        grouping: Settings of the grouping.
    """
    rows = slice(outputs.sample.distinct)
    idx = outputs.sample.point_idx[rows]
    embedding, confidence, categories = outputs.embedding[rows], outputs.confidence[rows], outputs.categories[rows]
    groups: Groups
    if isinstance(grouping, GroupMergingConfig):
        groups = merge_groups(embedding, confidence, xyz[idx], grouping, classes=categories)
    else:
        groups = group_points(embedding, confidence, xyz[idx], np.inf, grouping)
    return SampleGroups(point_idx=idx, groups=groups.labels, categories=categories, confidences=confidence)


def merge_samples(outputs: Iterable[SampleOutputs], room: Room, config: RoomPredictorConfig) -> list[Instance]:
    """Return the objects of a room, best confidence first."""
    return merge_samples_at([config.grouping], outputs, room, config)[0]


def merge_samples_at(
    groupings: Sequence[GroupingConfig | GroupMergingConfig],
    outputs: Iterable[SampleOutputs],
    room: Room,
    config: RoomPredictorConfig,
) -> list[list[Instance]]:
    """Return the objects of a room for each of several groupings; the network runs once."""
    mergers = [BlockMerger(room.xyz, config.merging) for _ in groupings]
    for sample in outputs:
        for merger, grouping in zip(mergers, groupings, strict=True):
            merger.add(group_sample(sample, room.xyz, grouping))
    min_sizes = None if config.min_sizes is None else np.array(config.min_sizes)
    return [merger.instances(min_sizes) for merger in mergers]


@dataclass(frozen=True, kw_only=True)
class RoomPredictor:
    """Prediction of rooms with the weights of a file. It can be pickled: another process loads the weights itself.

    Attributes:
        weights: ``.safetensors`` file of a training on rooms.
        config: Settings of the prediction.
        device: Device of the computation.
    """

    weights: Path
    config: RoomPredictorConfig
    device: str = "cpu"

    @classmethod
    def from_file(cls, weights: Path, device: str = "cpu", threshold: float | None = None) -> "RoomPredictor":
        """Return the predictor of a file of weights, with the settings in its record.

        Args:
            weights: File that a training on rooms has written.
            device: Device of the computation.
            threshold: Threshold of the grouping. Unless given, it is the one chosen on held-out rooms, or else that of
                the loss.

        Raises:
            WeightsError: The file holds no network of this project, or one that was not trained on rooms.
        """
        return cls(weights=weights, config=config_of(weights, load_record(weights), threshold), device=device)

    def __call__(self, room: Room, rng: np.random.Generator) -> list[Instance]:
        """Return the objects of a room, best confidence first.

        Args:
            room: Room to predict.
            rng: Source of the division of blocks into samples.
        """
        network = _network(self.weights, local_file(self.weights).stat().st_mtime_ns, self.device)
        return merge_samples(describe_room(network, room, rng, self.config, self.device), room, self.config)

    def with_grouping(self, grouping: GroupingConfig | GroupMergingConfig) -> "RoomPredictor":
        """Return this predictor with another grouping."""
        return replace(self, config=replace(self.config, grouping=grouping))


def config_of(weights: Path, record: dict[str, Any], threshold: float | None = None) -> RoomPredictorConfig:
    """Return the settings of the prediction from the record of a training; see `RoomPredictor.from_file`.

    Raises:
        WeightsError: The network was not trained on rooms.
    """
    try:
        training, chosen = record["training"], (record["validation"] or {}).get("threshold")
        pairs, points = PairLossConfig(**training["pairs"]), int(training["points"])
        return RoomPredictorConfig(
            grouping=sample_grouping(points, pairs, chosen if threshold is None else threshold),
            blocks=BlockConfig(points=points),
            min_sizes=tuple(float(record["min_sizes"][name]) for name in CATEGORIES),
            colour=sees_colour(SgpnConfig(in_channels=record["network"]["in_channels"])),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise WeightsError(f"{weights} holds no network of a training on rooms ({error!r})") from error


@lru_cache(maxsize=2)
def _network(weights: Path, written: int, device: str) -> torch.nn.Module:  # noqa: ARG001
    """Return the network of a file; ``written``, its time stamp, is part of the cache's key."""
    return load_network(weights).to(device)
