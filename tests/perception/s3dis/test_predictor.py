"""Rooms to objects by a network: a network that says the truth scores 1, and what a file's record says is used."""

import pickle
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from perception.instance import Instance
from perception.s3dis.data.blocks import BlockConfig
from perception.s3dis.data.categories import CATEGORIES
from perception.s3dis.data.room import Room
from perception.s3dis.predictor import (
    RoomPredictor,
    RoomPredictorConfig,
    SampleOutputs,
    config_of,
    describe_room,
    group_sample,
    merge_samples,
    merge_samples_at,
    sample_grouping,
)
from perception.s3dis.scoring import S3disScores, match_room
from perception.segmentation.grouping.group_merging import GroupMergingConfig
from perception.segmentation.networks.distance import SQUARE_SCALE
from perception.segmentation.networks.output import PointOutputs
from perception.segmentation.networks.sgpn import Sgpn, SgpnConfig
from perception.segmentation.training.losses import PairLossConfig
from perception.segmentation.weights import WeightsError, save_network
from tests.perception.s3dis.s3dis_tree import boxes_room, told_by_colour_room

BLOCKS = BlockConfig(points=256)
CONFIG = RoomPredictorConfig(grouping=sample_grouping(256), blocks=BLOCKS)
NETWORK = SgpnConfig(trunk="pointnet", in_channels=9, num_classes=13, embedding=4, branch=4, global_width=8)
RECORD: dict[str, Any] = {
    "row": "sgpn-colour",
    "training": {"pairs": asdict(PairLossConfig(kind="double_hinge")), "points": 128},
    "validation": {"threshold": 3.0},
    "min_sizes": dict.fromkeys(CATEGORIES, 30.0),
}


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def truthful(points_BNC: torch.Tensor) -> PointOutputs:
    """Read instance and category off the colours of `told_by_colour_room`: objects are 20 apart in the embedding."""
    instance_BN, category_BN = ((points_BNC[..., k] * 255).round() for k in (3, 4))
    category_BN = category_BN.clamp(max=12)
    return PointOutputs(
        embedding_BNF=instance_BN[..., None] * 20,
        confidence_BN=torch.full_like(instance_BN, 0.9),
        semantics_BNS=torch.nn.functional.one_hot(category_BN.long(), 13).float(),
    )


def predicted(room: Room, rng: np.random.Generator, config: RoomPredictorConfig = CONFIG) -> list[Instance]:
    return merge_samples(describe_room(truthful, room, rng, config), room, config)


@pytest.mark.parametrize("grouping", [sample_grouping(256), GroupMergingConfig(min_points=5)], ids=["ours", "merging"])
def test_outputs_like_the_ground_truth_score_one(grouping) -> None:
    # Samples as large as the blocks: small ones break an object's corner into groups too small to be merged.
    config = replace(CONFIG, grouping=grouping, blocks=BlockConfig(points=2048))
    matches = [
        match_room(lambda room, rng: predicted(room, rng, config), told_by_colour_room(seed, f"Area_5/office_{seed}"))
        for seed in (31, 32, 33)
    ]
    scores = S3disScores.of(matches)
    assert (scores.mean_ap50, scores.ap25, scores.ap) == (1.0, 1.0, 1.0)
    assert {name: value for name, value in scores.ap50.items() if not np.isnan(value)} == dict.fromkeys(
        ("column", "door", "table", "chair", "sofa", "board"), 1.0
    )


def test_every_point_is_described_whatever_the_batch() -> None:
    room = told_by_colour_room()
    for batch in (1, 3):
        said = list(describe_room(truthful, room, np.random.default_rng(0), replace(CONFIG, batch=batch)))
        assert len(np.unique(np.concatenate([s.sample.point_idx for s in said]))) == len(room)
        for sample in said:
            assert np.array_equal(sample.categories, room.semantic[sample.sample.point_idx])
            assert np.array_equal(sample.embedding[:, 0] / 20, room.instance[sample.sample.point_idx])


def test_a_network_without_colour_sees_none() -> None:
    seen: list[int] = []

    def network(points_BNC: torch.Tensor) -> PointOutputs:
        seen.append(points_BNC.shape[2])
        zeros_BN = points_BNC[..., 0] * 0
        return PointOutputs(zeros_BN[..., None], zeros_BN, zeros_BN[..., None].expand(-1, -1, 13))

    list(describe_room(network, told_by_colour_room(), np.random.default_rng(0), replace(CONFIG, colour=False)))
    assert set(seen) == {6}


def test_a_group_is_of_the_mode_of_its_points_and_as_sure_as_their_mean() -> None:
    room = boxes_room([("chair", (0, 0, 0)), ("table", (0.6, 0, 0))], points=300)
    chance = np.random.default_rng(0)
    (said,) = describe_room(truthful, room, chance, replace(CONFIG, blocks=BlockConfig(points=600)))
    is_chair = room.instance[said.sample.point_idx] == 0
    wrong = chance.random(600) < 0.4
    categories = np.where(is_chair ^ wrong, CATEGORIES.index("chair"), CATEGORIES.index("table"))
    confidence = np.where(is_chair, 0.75, np.where(wrong, 0.25, 0.5)).astype(np.float32)
    embedding = np.where(is_chair, 0.0, 20.0)[:, None].astype(np.float32)
    found = merge_samples([SampleOutputs(said.sample, embedding, confidence, categories)], room, CONFIG)
    assert [CATEGORIES[instance.label] for instance in found] == ["chair", "table"]
    assert [len(instance.point_idx) for instance in found] == [300, 300]
    assert [instance.score for instance in found] == pytest.approx([0.75, confidence[~is_chair].mean()])


def test_points_that_fill_a_sample_up_count_once() -> None:
    room = boxes_room([("chair", (0, 0, 0))], points=200)
    (said,) = describe_room(truthful, room, np.random.default_rng(0), CONFIG)
    assert (said.sample.distinct, len(said.embedding)) == (200, 256)
    groups = group_sample(said, room.xyz, sample_grouping(256))
    assert sorted(groups.point_idx) == list(range(200))
    assert len(groups.confidences) == 200


def test_several_groupings_share_the_network() -> None:
    room = told_by_colour_room()
    fine, coarse = sample_grouping(256, threshold=5.0), sample_grouping(256, threshold=1e4)
    said = describe_room(truthful, room, np.random.default_rng(0), CONFIG)
    several, one = merge_samples_at([fine, coarse], said, room, CONFIG)
    for found, exact in ((several, True), (one, False)):
        purity = [len(np.unique(room.instance[instance.point_idx])) for instance in found]
        assert (max(purity) == 1) is exact


def test_small_objects_are_dropped_by_category() -> None:
    room = told_by_colour_room()
    sizes = tuple(401.0 if name == "chair" else 0.0 for name in CATEGORIES)
    found = predicted(room, np.random.default_rng(0), replace(CONFIG, min_sizes=sizes))
    assert {CATEGORIES[instance.label] for instance in found} == {CATEGORIES[k] for k in np.unique(room.semantic)} - {
        "chair"
    }


def test_groups_may_be_as_small_as_the_sample_allows_and_the_loss_says_the_threshold() -> None:
    assert [sample_grouping(points).min_points for points in (4096, 1024, 10)] == [50, 12, 1]
    assert sample_grouping(64, PairLossConfig()).threshold == 7.5
    released = PairLossConfig(kind="double_hinge", distance="scaled_square")
    assert sample_grouping(64, released).threshold == 10
    assert sample_grouping(64, released).distance == "scaled_square"
    assert SQUARE_SCALE == 10
    assert not sample_grouping(64).d_max


def test_weights_are_used_as_their_record_says_also_in_another_process(tmp_path: Path) -> None:
    path, room = tmp_path / "weights.safetensors", told_by_colour_room()
    torch.manual_seed(3)
    save_network(path, Sgpn(NETWORK), RECORD)
    predict = RoomPredictor.from_file(path)
    assert predict.config.grouping == sample_grouping(128, PairLossConfig(kind="double_hinge"), 3.0)
    assert (predict.config.blocks.points, predict.config.colour) == (128, True)
    assert predict.config.min_sizes == (30.0,) * 13
    assert RoomPredictor.from_file(path, threshold=5.0).config.grouping.threshold == 5.0
    merging = predict.with_grouping(GroupMergingConfig())
    assert merging.config.grouping == GroupMergingConfig()
    sent = pickle.loads(pickle.dumps(predict))
    for mine, theirs in zip(predict(room, np.random.default_rng(1)), sent(room, np.random.default_rng(1)), strict=True):
        assert np.array_equal(mine.point_idx, theirs.point_idx)
        assert (mine.score, mine.label) == (theirs.score, theirs.label)


def test_a_network_without_a_threshold_of_its_own_takes_the_losss() -> None:
    record = RECORD | {"validation": None, "network": asdict(NETWORK)}
    assert config_of(Path("x"), record).grouping.threshold == 10.0


@pytest.mark.parametrize("missing", ["min_sizes", "training", "network"])
def test_weights_of_another_kind_are_named(missing: str) -> None:
    record = {name: value for name, value in (RECORD | {"network": asdict(NETWORK)}).items() if name != missing}
    with pytest.raises(WeightsError, match=rf"tee.safetensors holds no network of a training on rooms .*{missing}"):
        config_of(Path("tee.safetensors"), record)


def test_nonsense_settings_are_named() -> None:
    with pytest.raises(ValueError, match="batch must be at least 1, got 0"):
        RoomPredictorConfig(batch=0)
    with pytest.raises(ValueError, match="min_sizes must be 13 numbers, got 2"):
        RoomPredictorConfig(min_sizes=(1.0, 2.0))
