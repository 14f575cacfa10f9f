"""Training: it learns, it resumes to the bit, and it says what is wrong."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from perception.boundary import BoundaryCloud
from perception.instance import Instance, instances_of
from perception.segmentation.networks.grid_net import GridNetConfig
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.training import run as run_module
from perception.segmentation.training.checkpoint import FORMAT, CheckpointError, load_checkpoint, save_checkpoint
from perception.segmentation.training.dataset import Batch, BatchMaker
from perception.segmentation.training.errors import TrainingError
from perception.segmentation.training.loop import SKIPS, Length, StepRecord, Trainer, learning_rate
from perception.segmentation.training.packed import PackedScene
from perception.segmentation.training.presets import PRESETS, TrainingConfig, fine_tuning
from perception.segmentation.training.run import CHECKPOINT, LOG, WEIGHTS, RunConfig, read_log, resume, train, validate
from perception.segmentation.weights import Network, load_network, load_record, save_network
from tests.perception.disc_scene import disc_scene

SCENES = [PackedScene.pack(disc_scene(seed)) for seed in range(2)]
GRID = replace(
    PRESETS["ours"], network=GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=2), batch=1, points=64, warmup=2
)
CLOUD = replace(
    PRESETS["paper"], network=SgpnConfig(trunk="pointnet", embedding=8, branch=8, global_width=16), points=64, batch=2
)
KINDS = pytest.mark.parametrize("config", [GRID, CLOUD], ids=["grid", "cloud"])


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def trainer(config: TrainingConfig, steps: int = 4) -> Trainer:
    return Trainer(config, BatchMaker.of(config, SCENES), Length(steps=steps))


def weights(of: Trainer) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in of.best_network().state_dict().items()}


def assert_same(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> None:
    assert first.keys() == second.keys()
    assert [name for name in first if not torch.equal(first[name], second[name])] == []


@pytest.mark.slow
@KINDS
def test_the_same_seed_gives_the_same_bits_and_another_one_others(config: TrainingConfig) -> None:
    first, second, other = trainer(config), trainer(config), trainer(replace(config, seed=1))
    for one in (first, second, other):
        list(one.run())
    assert_same(weights(first), weights(second))
    assert any(not torch.equal(a, b) for a, b in zip(weights(first).values(), weights(other).values(), strict=True))


@KINDS
def test_a_training_that_was_killed_goes_on_to_the_bit(config: TrainingConfig, tmp_path: Path) -> None:
    whole = trainer(config)
    list(whole.run())
    killed = trainer(config)
    steps = killed.run()
    next(steps), next(steps)
    save_checkpoint(tmp_path / CHECKPOINT, killed)
    resumed = trainer(config)
    load_checkpoint(tmp_path / CHECKPOINT, resumed)
    assert resumed.step == 2
    assert [record.step for record in resumed.run()] == [3, 4]
    assert_same(weights(whole), weights(resumed))


@pytest.mark.slow
def test_the_loss_falls() -> None:
    config = replace(GRID, batch=2, bf16=False, warmup=0, learning_rate=5e-3)
    losses = [record.losses["total"] for record in trainer(config, steps=40).run()]
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])


def test_the_rate_warms_up_and_falls_as_a_cosine() -> None:
    config = replace(GRID, learning_rate=1.0, warmup=10, final_rate=0.0)
    assert learning_rate(config, 0, 0.0) == pytest.approx(0.1)
    assert learning_rate(config, 100, 0.5) == pytest.approx(0.5)
    assert learning_rate(config, 100, 1.0) == pytest.approx(0.0)
    assert learning_rate(replace(config, schedule="constant", warmup=0), 7, 0.9) == 1.0


def test_length_is_steps_or_minutes() -> None:
    assert Length(steps=10).progress(5, 1e9) == 0.5
    assert Length(minutes=2.0).progress(10**9, 60.0) == 0.5
    assert Length(minutes=2.0).progress(0, 600.0) == 1.0
    for values in ({}, {"steps": 1, "minutes": 1.0}, {"steps": 0}, {"minutes": -1.0}):
        with pytest.raises(ValueError, match="give either steps or minutes, positive"):
            Length(**values)


def test_updates_that_are_not_finite_are_left_out_and_end_the_training_if_they_go_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken = trainer(replace(GRID, bf16=False), steps=100)
    before = weights(broken)
    monkeypatch.setattr(
        "perception.segmentation.training.loop.pair_loss", lambda embedding, *_, **__: embedding.sum() * float("nan")
    )
    records: list[StepRecord] = []
    with pytest.raises(TrainingError, match=rf"not finite {SKIPS + 1} times in a row.*lower learning rate"):
        records.extend(broken.run())
    learned = {name for name, _ in broken.network.named_parameters()}
    assert [name for name in learned if not torch.equal(before[name], broken.network.state_dict()[name])] == []


def test_a_forward_pass_that_is_not_finite_leaves_no_trace(tmp_path: Path) -> None:
    config, makes = replace(GRID, bf16=False), BatchMaker.of(GRID, SCENES)

    class OnceBroken:
        scenes, rank = makes.scenes, 0

        def __call__(self, step: int) -> Batch:
            batch = makes(step)
            if step == 1:
                batch.inputs.cells_BCHW[0, 0, 5, 5] = torch.nan
            return batch

        def digest(self) -> str:
            return "broken"

    one = Trainer(config, OnceBroken(), Length(steps=4))
    log = RunConfig(out=tmp_path, parts=("disc",), evaluate_every=1e-9)
    skipped: list[bool] = []
    train(one, [], log, lambda record: skipped.append(record.skipped))
    assert skipped == [False, True, False, False]
    for network in (one.network, one.averaged):
        assert all(torch.isfinite(value).all() for value in network.state_dict().values())
    lines = [json.loads(line) for line in (tmp_path / LOG).read_text().splitlines()]
    assert all(np.isfinite(value) for line in lines for value in line["losses"].values())


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("offset_weight", -1.0, "offset_weight must not be negative, got -1.0"),
        ("learning_rate", 0.0, "learning_rate must be positive, got 0.0"),
        ("batch", 0, "batch must be positive, got 0"),
        ("clip", 0.0, "clip must be positive, got 0.0"),
        ("ema", 1.0, r"ema must be in \[0, 1\), got 1.0"),
    ],
)
def test_nonsense_settings_are_named(field: str, value: float, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        replace(GRID, **{field: value})


def test_the_papers_preset_is_its_text() -> None:
    paper, released = PRESETS["paper"], PRESETS["released"]
    assert (paper.optimizer, paper.learning_rate, paper.batch, paper.points) == ("adam", 1e-4, 2, 4096)
    pairs = paper.pairs
    assert (pairs.kind, pairs.distance, pairs.same, pairs.other, pairs.category, pairs.beta) == (
        "focal_double_hinge", "l2", 5.0, 10.0, 80.0, 2.0,
    )  # fmt: skip
    assert [paper.alpha(epoch) for epoch in (0, 4.9, 5, 12, 200)] == [2, 2, 4, 6, 10]
    assert (released.pairs.kind, released.pairs.distance) == ("double_hinge", "scaled_square")


def test_a_checkpoint_of_another_training_is_refused(tmp_path: Path) -> None:
    path = tmp_path / CHECKPOINT
    save_checkpoint(path, trainer(GRID))
    with pytest.raises(
        CheckpointError, match=r"belongs to another training \(batch: 1 there, 2 here\); choose another"
    ):
        load_checkpoint(path, trainer(replace(GRID, batch=2)))
    others = BatchMaker.of(GRID, [replace(SCENES[0], name="scene_9"), *SCENES[1:]])
    with pytest.raises(CheckpointError, match=r"belongs to another training \(scenes: .* there, .* here\)"):
        load_checkpoint(path, Trainer(GRID, others, Length(steps=4)))
    whole = path.read_bytes()
    FORMAT.save_tensors(path, {"network/nothing": torch.zeros(1)}, FORMAT.load_header(path))
    with pytest.raises(CheckpointError, match="does not fit the network of its own settings"):
        load_checkpoint(path, trainer(GRID))
    path.write_bytes(whole[:100])
    with pytest.raises(CheckpointError, match="does not hold a complete checkpoint"):
        load_checkpoint(path, trainer(GRID))


def test_a_run_writes_log_checkpoint_and_weights(tmp_path: Path) -> None:
    scene = tmp_path / "scene_00000.npz"
    disc_scene(9).save(scene)
    config = RunConfig(out=tmp_path / "out", parts=("disc",), evaluate_every=1e-9, save_every=1e-9)
    assert not resume(trainer(GRID), config)
    seen: list[int] = []
    lines: list[dict[str, object]] = []
    one = trainer(GRID, steps=2)
    last = train(one, [scene], config, lambda record: seen.append(record.step), lines.append)
    assert seen == [1, 2]
    logged = [json.loads(line) for line in (config.out / LOG).read_text().splitlines()]
    assert [line["step"] for line in logged] == [1, 2, 2]
    assert set(logged[-1]["validation"]) == {"ap", "ap50", "ap75", "ms_per_scene"}
    record = load_record(config.out / WEIGHTS)
    assert (record["parts"], record["steps"], record["scenes"]) == (["disc"], 2, 2)
    assert record["training"]["pairs"]["kind"] == "focal_double_hinge"
    assert record["validation"]["ap50"] == last["validation"]["ap50"]
    assert_same(weights(one), load_network(config.out / WEIGHTS).state_dict())
    again = trainer(GRID, steps=2)
    assert resume(again, config)
    assert again.progress == 1.0


def test_a_training_that_is_killed_before_its_last_line_logs_the_same_losses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise SystemExit

    config = RunConfig(out=tmp_path, parts=("disc",))
    whole = train(trainer(GRID, steps=2), [], replace(config, out=tmp_path / "whole"))
    with monkeypatch.context() as patch:
        patch.setattr(run_module, "_log_line", killed)
        with pytest.raises(SystemExit):
            train(trainer(GRID, steps=2), [], config)
    resumed = trainer(GRID, steps=2)
    assert resume(resumed, config)
    assert train(resumed, [], config)["losses"] == whole["losses"]
    assert len(whole["losses"]) > 0


def test_a_training_may_start_from_the_weights_of_another(tmp_path: Path) -> None:
    first = trainer(GRID, steps=2)
    train(first, [], RunConfig(out=tmp_path / "first", parts=("disc",)))
    config = RunConfig(out=tmp_path / "second", parts=("disc",), initial=tmp_path / "first" / WEIGHTS)
    second = trainer(GRID, steps=1)
    assert not resume(second, config)
    assert_same(weights(first), weights(second))
    train(second, lambda network: {"ap": 0.5}, config)
    assert load_record(config.out / WEIGHTS)["initial"]["steps"] == 2
    assert [line["step"] for line in read_log(config.out / LOG)] == [0, 1]
    with pytest.raises(
        TrainingError, match=r"the initial weights are of GridNetConfig.*this training is of SgpnConfig"
    ):
        resume(trainer(CLOUD), replace(config, out=tmp_path / "third"))


def test_a_network_that_is_told_the_shape_may_start_from_one_that_is_not() -> None:
    told = replace(GRID, network=replace(GRID.network, shape=True))
    first, second = trainer(replace(GRID, seed=1)), trainer(told)
    second.start_from(first.network)
    state = weights(second)
    assert_same(weights(first), {name: value for name, value in state.items() if not name.startswith("shape.")})
    assert not any(value.any() for name, value in state.items() if name.startswith("shape."))
    second.start_from(trainer(replace(told, seed=2)).network)
    with pytest.raises(TrainingError, match=r"shape=True.*this training is of .*shape=False"):
        first.start_from(second.network)


def test_a_checkpoint_from_before_networks_were_told_the_shape_resumes(tmp_path: Path) -> None:
    path = tmp_path / CHECKPOINT
    save_checkpoint(path, trainer(GRID))
    assert "shape" not in FORMAT.load_header(path)["network"]
    load_checkpoint(path, trainer(GRID))


def test_the_initial_weights_are_evaluated_first_and_a_new_training_begins_a_new_log(tmp_path: Path) -> None:
    start = tmp_path / "start.safetensors"
    save_network(start, trainer(replace(GRID, seed=5)).network, {})
    config = RunConfig(out=tmp_path / "out", parts=("disc",), initial=start, scene_minutes=1.5)
    judged: list[dict[str, torch.Tensor]] = []

    def judge(network: Network) -> dict[str, float]:
        judged.append({name: value.clone() for name, value in network.state_dict().items()})
        return {"ap": 0.1 * len(judged)}

    for _ in range(2):
        judged.clear()
        (tmp_path / "out" / CHECKPOINT).unlink(missing_ok=True)
        one = trainer(GRID, steps=1)
        assert not resume(one, config)
        train(one, judge, config)
        assert_same(judged[0], load_network(start).state_dict())
        lines = [json.loads(line) for line in (config.out / LOG).read_text().splitlines()]
        assert [(line["step"], line["validation"]["ap"], line["scene_minutes"]) for line in lines] == [
            (0, 0.1, 1.5),
            (1, 0.2, 1.5),
        ]
    assert load_record(config.out / WEIGHTS)["scene_minutes"] == 1.5


def test_a_resumed_training_names_the_weights_that_it_did_start_from(tmp_path: Path) -> None:
    for name in ("first", "second"):
        save_network(tmp_path / name, trainer(GRID).network, {"parts": [name], "versions": {"torch": name}})
    one, other = (RunConfig(out=tmp_path, parts=("disc",), initial=tmp_path / name) for name in ("first", "second"))
    begun = trainer(GRID, steps=1)
    resume(begun, one)
    train(begun, [], one)
    resumed = trainer(GRID, steps=1)
    assert resume(resumed, other)
    train(resumed, [], other)
    assert load_record(tmp_path / WEIGHTS)["initial"]["parts"] == ["first"]
    older = FORMAT.load_header(tmp_path / CHECKPOINT)
    del older["initial"]
    FORMAT.save_tensors(tmp_path / CHECKPOINT, load_file(tmp_path / CHECKPOINT), older)
    resumed = trainer(GRID, steps=1)
    resume(resumed, other)
    assert resumed.initial is not None
    assert resumed.initial["parts"] == ["second"]  # older checkpoints do not tell


def test_a_log_is_read_without_lines_that_were_cut_off(tmp_path: Path) -> None:
    assert read_log(tmp_path / LOG) == []
    (tmp_path / LOG).write_text('{"step": 2, "minutes": 1}\n{"step": 4, "mi\n{"step": 0}\n{"step": 2, "minutes": 3}\n')
    assert read_log(tmp_path / LOG) == [{"step": 0}, {"step": 2, "minutes": 3}]


def test_fine_tuning_is_gentler_and_never_steeper_than_its_preset() -> None:
    ours = PRESETS["ours"]
    tuned = fine_tuning(ours)
    assert tuned.learning_rate < ours.learning_rate
    assert tuned.warmup < ours.warmup
    assert replace(tuned, learning_rate=ours.learning_rate, warmup=ours.warmup) == ours
    gentle = replace(ours, learning_rate=1e-6, warmup=0)
    assert fine_tuning(gentle) == gentle


def test_ctrl_c_keeps_the_state(tmp_path: Path) -> None:
    config = RunConfig(out=tmp_path, parts=("disc",))

    def interrupt(record: StepRecord) -> None:
        if record.step == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(trainer(GRID), [], config, interrupt)
    resumed = trainer(GRID)
    assert resume(resumed, config)
    assert resumed.step == 2


def test_ctrl_c_within_a_step_keeps_the_last_whole_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = RunConfig(out=tmp_path, parts=("disc",), save_every=1e-9)
    torn = trainer(GRID)
    average, calls = torn._average, []

    def interrupted() -> None:
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt  # the optimizer has stepped, the count has not
        average()

    monkeypatch.setattr(torn, "_average", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(torn, [], config)
    resumed, whole = trainer(GRID), trainer(GRID)
    assert resume(resumed, config)
    assert resumed.step == 2
    list(resumed.run()), list(whole.run())
    assert_same(weights(whole), weights(resumed))


def test_several_processes_leave_writing_to_the_first(tmp_path: Path) -> None:
    config = RunConfig(out=tmp_path / "out", parts=("disc",), leader=False)
    assert train(trainer(GRID, steps=1), [], config) == {}
    assert not config.out.exists()


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"parts": ()}, "parts must name at least one part"),
        ({"save_every": 0.0}, "save_every must be positive, got 0.0"),
        ({"scene_minutes": -1.0}, "scene_minutes must not be negative, got -1.0"),
    ],
)
def test_nonsense_runs_are_named(values: dict[str, object], text: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=text):
        RunConfig(**{"out": tmp_path, "parts": ("disc",)} | values)


def test_validation_pools_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [disc_scene(k) for k in range(2)]
    for k, scene in enumerate(scenes):
        scene.save(tmp_path / f"scene_{k:05d}.npz")

    def truth(self: object, boundary: BoundaryCloud, *_: object) -> list[Instance]:
        (scene,) = (s for s in scenes if np.array_equal(s.boundary.pixels, boundary.pixels))
        return instances_of(scene.instance_ids, np.ones(len(scene.centres_cam)))

    monkeypatch.setattr(run_module.SegmentationPredictor, "predict", truth)
    found = validate(trainer(GRID).best_network(), sorted(tmp_path.glob("*.npz")))
    assert (found["ap"], found["ap50"], found["ap75"]) == (1.0, 1.0, 1.0)
