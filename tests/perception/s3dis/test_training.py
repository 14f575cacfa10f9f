"""Trainings on rooms: the shared loop with 13 classes learns, resumes to the bit and tells categories apart by M3."""

import runpy
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from perception.s3dis.data.categories import CATEGORIES
from perception.s3dis.data.dataset import BlockBatches, PackedRoom
from perception.s3dis.data.room import Room, mean_sizes, room_path
from perception.s3dis.predictor import RoomPredictor
from perception.s3dis.presets import ROWS, row_training
from perception.s3dis.scoring import S3disScores, match_room
from perception.s3dis.training import RowTraining, judge_thresholds, train_row
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.training.checkpoint import load_checkpoint, save_checkpoint
from perception.segmentation.training.loop import Length, Trainer, to_device
from perception.segmentation.training.losses import PairLossConfig, PointAttributes, pair_loss
from perception.segmentation.training.run import CHECKPOINT, WEIGHTS
from perception.segmentation.weights import load_network, load_record
from tests.perception.s3dis.s3dis_tree import boxes_room, told_by_colour_room
from tests.perception.s3dis.test_predictor import truthful

pytestmark = pytest.mark.slow

TWIN = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[2] / "reference" / "losses_twin.py")))
ROOMS = [PackedRoom.pack(told_by_colour_room(seed, f"Area_{seed}/office_1")) for seed in (1, 2)]
TINY = SgpnConfig(in_channels=9, num_classes=13, embedding=8, branch=8, global_width=16, k=6)


def tiny(row: str, points: int = 48):
    config = row_training(row, "small")
    network = replace(TINY, trunk=config.network.trunk, in_channels=config.network.in_channels)
    return replace(config, network=network, batch=2, points=points, pairs=replace(config.pairs, anchors=None))


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def trainer(config, steps: int = 4) -> Trainer:
    return Trainer(config, BlockBatches.of(config, ROOMS), Length(steps=steps))


@pytest.mark.parametrize("row", ROWS)
def test_a_row_that_was_killed_goes_on_to_the_bit(row: str, tmp_path: Path) -> None:
    whole, killed, resumed = (trainer(tiny(row)) for _ in range(3))
    list(whole.run())
    steps = killed.run()
    next(steps), next(steps)
    save_checkpoint(tmp_path / CHECKPOINT, killed)
    load_checkpoint(tmp_path / CHECKPOINT, resumed)
    assert [record.step for record in resumed.run()] == [3, 4]
    for mine, theirs in zip(
        whole.best_network().state_dict().values(), resumed.best_network().state_dict().values(), strict=True
    ):
        assert torch.equal(mine, theirs)


@pytest.mark.parametrize("row", ["sgpn-colour", "dgcnn-new-colour"])
def test_the_loop_trains_the_twins_loss_with_its_third_case(row: str) -> None:
    config = tiny(row)
    one = trainer(config, steps=1)
    batch = to_device(BlockBatches.of(config, ROOMS)(0), torch.device("cpu"))
    assert len(batch.class_ids_BN.unique()) > 2
    one.network.train()
    with torch.no_grad():
        outputs = one.network(batch.inputs)
    fresh = trainer(config, steps=1)
    (record,) = fresh.run()
    ids, classes = batch.instance_ids_BN.tolist(), batch.class_ids_BN.tolist()
    embedding = outputs.embedding_BNF.double().tolist()
    expected = TWIN.pair_loss(embedding, ids, config.pairs, config.alpha(0.0), class_ids=classes)
    assert record.losses["pairs"] == pytest.approx(expected, rel=1e-4)
    assert expected > 1.2 * TWIN.pair_loss(embedding, ids, config.pairs, config.alpha(0.0))  # the third case is there
    semantic = TWIN.semantic_loss(outputs.semantics_BNS.double().tolist(), classes)
    assert record.losses["semantics"] == pytest.approx(semantic, rel=1e-4)
    confidence = TWIN.confidence_loss(
        outputs.confidence_BN.double().tolist(), embedding, ids, config.pairs, config.pairs.threshold
    )
    assert record.losses["confidence"] == pytest.approx(confidence, rel=1e-3)


@pytest.mark.parametrize("kind", ["double_hinge", "focal_double_hinge"])
@pytest.mark.parametrize("distance", ["l2", "scaled_square"])
def test_the_third_cases_gradient_is_the_twins_difference_quotient(kind: str, distance: str) -> None:
    config = PairLossConfig(kind=kind, distance=distance, anchors=None)
    generator = torch.Generator().manual_seed(5)
    # Every point is an object and a category of its own, but for the last two: distances on both sides of M3.
    reach = 40.0 if distance == "l2" else 1.5
    embedding = torch.randn(1, 7, 3, generator=generator, dtype=torch.float64) * reach
    embedding[0, 1] = embedding[0, 0] + 0.01 * reach
    ids, classes = torch.tensor([[0, 1, 2, 3, 4, 5, 5]]), torch.tensor([[0, 1, 2, 3, 4, 5, 5]])
    lengths = torch.cdist(embedding, embedding)[0]
    margin = 80.0 if distance == "l2" else 8.0**0.5
    assert (lengths[:6, :6] > margin).any()
    assert ((lengths[:6, :6] < margin).sum() > 6).all()
    free = embedding.clone().requires_grad_()
    pair_loss(free, ids, config, 2.0, attributes=PointAttributes(classes)).backward()
    step = 1e-6 * reach
    for point in range(7):
        for axis in range(3):
            values = []
            for sign in (1, -1):
                moved = embedding.clone()
                moved[0, point, axis] += sign * step
                values.append(TWIN.pair_loss(moved.tolist(), ids.tolist(), config, 2.0, class_ids=classes.tolist()))
            assert free.grad[0, point, axis].item() == pytest.approx((values[0] - values[1]) / (2 * step), abs=1e-5)


def test_a_tiny_block_is_overfitted_to_the_right_objects(tmp_path: Path) -> None:
    objects = [("chair", (0.0, 0.0, 0.0)), ("chair", (0.55, 0.0, 0.0)), ("table", (0.0, 0.55, 0.2))]
    room = boxes_room(objects, points=110, name="Area_1/office_1")
    room.save(room_path(tmp_path, room.name))
    config = replace(tiny("dgcnn-new-colour", points=330), learning_rate=1e-2, warmup=5, ema=None)
    config = replace(config, network=replace(config.network, embedding=16, branch=32, global_width=32, k=8))
    one = Trainer(config, BlockBatches.of(config, [PackedRoom.pack(room)]), Length(steps=40))
    losses = [record.losses["total"] for record in one.run()]
    assert np.mean(losses[-5:]) < 0.2 * np.mean(losses[:5])
    found = judge_thresholds(one.best_network(), [room_path(tmp_path, room.name)], config, [0.0] * 13)
    assert (found["ap50"], found["ap25"]) == (1.0, 1.0)


def test_thresholds_are_judged_on_rooms_and_the_losss_own_wins_a_tie(tmp_path: Path) -> None:
    paths = []
    for seed in (1, 2):
        room = told_by_colour_room(seed, f"Area_{seed}/office_1")
        paths.append(room_path(tmp_path, room.name))
        room.save(paths[-1])
    for row, expected in (("sgpn-colour", 10.0), ("dgcnn-new-colour", 7.5)):
        found = judge_thresholds(truthful, paths, replace(row_training(row, "small"), points=2048), [0.0] * 13)
        assert found == {"threshold": expected, "ap50": 1.0, "ap25": 1.0, "ap": 1.0}
    near = lambda points: truthful(points)._replace(embedding_BNF=truthful(points).embedding_BNF / 40)  # noqa: E731
    found = judge_thresholds(near, paths, replace(row_training("sgpn-colour", "small"), points=2048), [0.0] * 13)
    assert found["threshold"] in (1.0, 2.0)  # 10 |df|^2 is 2.5 between objects
    assert found["ap50"] == 1.0


@pytest.fixture
def rooms(tmp_path: Path) -> Path:
    """Return a folder of six rooms, one of an area."""
    for area in range(1, 7):
        room = told_by_colour_room(area, f"Area_{area}/office_1", points=150)
        room.save(room_path(tmp_path / "rooms", room.name))
    return tmp_path / "rooms"


def test_a_row_is_trained_without_area_5_and_its_weights_know_how_to_be_used(rooms: Path, tmp_path: Path) -> None:
    training = RowTraining(
        rooms=rooms, row="sgpn-colour", budget="small", steps=2, held_out=2, points=64, out=tmp_path / "out"
    )
    steps: list[int] = []
    last = train_row(training, on_step=lambda record: steps.append(record.step))
    assert steps == [1, 2]
    record = load_record(tmp_path / "out" / WEIGHTS)
    assert record["trained_on"] == [f"Area_{area}/office_1" for area in (2, 4, 6)]
    assert record["held_out"] == [f"Area_{area}/office_1" for area in (1, 3)]
    trained = [Room.load(room_path(rooms, name)) for name in record["trained_on"]]
    assert [record["min_sizes"][name] for name in CATEGORIES] == pytest.approx(0.25 * mean_sizes(trained))
    assert (record["row"], record["budget"], record["parts"], record["steps"]) == ("sgpn-colour", "small", ["s3dis"], 2)
    assert record["validation"] == last["validation"]
    assert set(last["validation"]) == {"threshold", "ap50", "ap25", "ap"}
    predict = RoomPredictor.from_file(tmp_path / "out" / WEIGHTS)
    assert predict.config.grouping.threshold == last["validation"]["threshold"]
    assert predict.config.blocks.points == 64
    assert load_network(tmp_path / "out" / WEIGHTS).config == row_training("sgpn-colour").network
    scores = S3disScores.of([match_room(predict, Room.load(room_path(rooms, "Area_5/office_1")))])
    assert 0 <= scores.mean_ap50 <= 1


def test_held_out_rooms_are_spread_and_never_trained_on(rooms: Path) -> None:
    for held_out in range(5):
        training, kept = RowTraining(rooms=rooms, held_out=held_out).files()
        assert len(kept) == held_out
        assert not set(training) & set(kept)
        assert {path.parent.name for path in (*training, *kept)} == {f"Area_{area}" for area in (1, 2, 3, 4, 6)}
    with pytest.raises(ValueError, match="held_out must be less than the 5 rooms to train on, got 5"):
        RowTraining(rooms=rooms, held_out=5).files()


def test_the_four_rows_are_those_of_the_paper() -> None:
    facts = [
        (config.network.trunk, config.network.in_channels, config.network.num_classes, config.pairs.kind)
        for config in map(row_training, ROWS)
    ]
    assert facts == [
        ("pointnet", 9, 13, "double_hinge"),
        ("dgcnn", 9, 13, "double_hinge"),
        ("dgcnn", 6, 13, "focal_double_hinge"),
        ("dgcnn", 9, 13, "focal_double_hinge"),
    ]
    for config in map(row_training, ROWS):
        assert (config.points, config.optimizer, config.learning_rate) == (4096, "adam", 1e-4)
        assert config.pairs.category == 80
    assert [row_training(row).batch for row in ROWS] == [4, 4, 2, 2]


def test_small_rows_differ_in_trunk_colour_and_equation_alone() -> None:
    plain = []
    for row in ROWS:
        values = asdict(row_training(row, "small"))
        del values["network"]["trunk"], values["network"]["in_channels"], values["pairs"]["kind"]
        plain.append(values)
    assert plain[0] == plain[1] == plain[2] == plain[3]


def test_the_papers_length_is_200_epochs_of_blocks() -> None:
    assert RowTraining(rooms=Path(), row="sgpn-colour").length(1000).steps == 200 * 1000 // 4
    assert RowTraining(rooms=Path(), row="sgpn-colour").length(1000, world=5).steps == 10_000
    assert RowTraining(rooms=Path(), steps=7).length(1000).steps == 7
    given = RowTraining(rooms=Path(), batch=3, points=5, learning_rate=0.5, seed=9)
    assert (given.config().batch, given.config().points, given.config().learning_rate, given.config().seed) == (
        3, 5, 0.5, 9,
    )  # fmt: skip
    assert given.folder() == Path("runs/s3dis-dgcnn-new-colour-paper-9")


def test_nonsense_is_named() -> None:
    with pytest.raises(ValueError, match="held_out must be 0 or more, got -1"):
        RowTraining(rooms=Path(), held_out=-1)
    with pytest.raises(ValueError, match=r"row must be one of sgpn-colour, .*dgcnn-new-colour, got 'unet'"):
        RowTraining(rooms=Path(), row="unet")
    with pytest.raises(ValueError, match="budget must be one of paper, small, got 'huge'"):
        row_training("dgcnn-new", "huge")


def test_rooms_with_nothing_to_find_leave_the_losss_threshold(tmp_path: Path) -> None:
    room = boxes_room([("clutter", (0, 0, 0))], points=99, name="Area_1/office_1")
    room.save(room_path(tmp_path, room.name))
    found = judge_thresholds(truthful, [room_path(tmp_path, room.name)], tiny("sgpn-colour", points=128), [0.0] * 13)
    assert found["threshold"] == 10.0
    assert np.isnan(found["ap50"])
