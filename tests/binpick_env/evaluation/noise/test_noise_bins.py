"""Every bin that a noise model is fitted to has the part, the seed, the sensor and the filling that were asked for."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binpick_env.cell.settle import SettleError
from binpick_env.config import CellConfig
from binpick_env.evaluation.noise import bins as module
from binpick_env.evaluation.noise.bins import FIRST_INDEX, NoiseBins, bin_path, load_bins, observe_bins
from binpick_env.evaluation.noise.comparison import FrameObservation
from binpick_env.options import CellOptions
from binpick_env.parts import load_part
from binpick_env.parts.families import FAMILIES, TRAINING_FAMILIES, parse_name
from binpick_env.parts.families.generator import VERSION
from binpick_env.parts.part import Part
from binpick_env.scenes.synthesis import SceneConfig, with_room

TEE = NoiseBins(options=CellOptions(sensor="harsh", friction=0.3), seed=5, num_parts=(2, 9))
MANY = NoiseBins(options=CellOptions(part="generated"), seed=1, num_parts=(2, 30))


class FakeEnv:
    """An environment whose only false candidate has its seed as score; the seeds in ``restless`` do not settle."""

    built: list[dict[str, Any]]
    restless: set[int]

    def __init__(self, part: Part, **settings: Any) -> None:
        self.built.append({"part": part.source, **settings})
        self.part, self.config = part, settings["config"]
        self.labelled_capture = "capture"

    def reset(self, *, seed: int) -> None:
        if seed in self.restless:
            raise SettleError("9 parts do not come to rest")
        self.observed = SimpleNamespace(seed=seed)


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Replace the environment by a fake one; return the settings of each that is built."""
    monkeypatch.setattr(FakeEnv, "built", [], raising=False)
    monkeypatch.setattr(FakeEnv, "restless", set(), raising=False)
    monkeypatch.setattr(module, "BinPickEnv", FakeEnv)
    monkeypatch.setattr(module, "_cells", {})
    monkeypatch.setattr(
        module,
        "compare_with_truth",
        lambda capture, observed: FrameObservation(parts=(), false_scores=(float(observed.seed),)),
    )
    return FakeEnv.built


def seed_of(config: NoiseBins, index: int) -> int:
    return int(np.random.SeedSequence([config.seed, index]).generate_state(1)[0])


def test_bins_are_observed_once_each_in_order_with_seeds_of_their_own(
    built: list[dict[str, Any]], tmp_path: Path
) -> None:
    assert list(observe_bins(TEE, 3, tmp_path / "a")) == [0, 1, 2]
    frames = [each.frame for each in load_bins(tmp_path / "a", 3)]
    assert [frame.false_scores for frame in frames if frame is not None] == [(seed_of(TEE, i),) for i in range(3)]
    settings = {"part": "tee", "num_parts": (2, 9), "perception": "learned", "threads": 1}
    hard = {**settings, "sensor": "harsh", "config": TEE.options.cell()}
    assert built == [hard]  # built once for all bins of the same settings
    good = NoiseBins(options=CellOptions(), seed=6, num_parts=(2, 9))
    list(observe_bins(good, 1, tmp_path / "b"))
    assert built[1:] == [{**settings, "sensor": "good", "config": CellConfig()}]
    assert len(module._cells) == 1  # one environment at a time is kept


def test_finished_bins_are_kept_and_others_not_mixed_in(built: list[dict[str, Any]], tmp_path: Path) -> None:
    list(observe_bins(TEE, 1, tmp_path))
    built.clear()
    module._cells.clear()
    assert list(observe_bins(TEE, 1, tmp_path)) == [0]
    assert built == []
    with pytest.raises(ValueError, match=r"holds bins of another configuration .seed: 5 there, 1 here"):
        list(observe_bins(NoiseBins(options=TEE.options, seed=1, num_parts=(2, 9)), 1, tmp_path))
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        list(observe_bins(TEE, 0, tmp_path))
    bin_path(tmp_path, 0).write_text("{}")
    with pytest.raises(ValueError, match=r"bin_00000.json holds no observed bin .*; delete it, and it is obs"):
        load_bins(tmp_path, 1)


@pytest.mark.usefixtures("built")
def test_a_pile_that_does_not_settle_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    FakeEnv.restless.add(seed_of(TEE, 0))
    list(observe_bins(TEE, 2, tmp_path))
    first, second = load_bins(tmp_path, 2)
    assert first.frame is None
    assert second.frame is not None
    assert "bin 0 of tee is left out: 9 parts do not come to rest" in caplog.text


def test_generated_parts_are_none_that_a_training_takes(built: list[dict[str, Any]], tmp_path: Path) -> None:
    """Every family has its turn; three bins in a row are of one part, with as many parts as the bin has room for."""
    parts = [MANY.options_of(index).part for index in range(3 * 2 * len(FAMILIES))]
    names = [parse_name(part) for part in parts]
    assert {name.family for name in names[: 3 * len(FAMILIES)]} == set(FAMILIES)
    assert {name.index for name in names} == {FIRST_INDEX, FIRST_INDEX + 1}
    assert [parts[k] == parts[k - 1] for k in range(1, 7)] == [True, True, False, True, True, False]
    assert MANY.many
    assert not TEE.many
    list(observe_bins(MANY, 4, tmp_path))
    assert [each["part"] for each in built] == [parts[0], parts[3]]
    assert json.loads((tmp_path / "bins.json").read_text())["generator"] == VERSION
    observed = load_bins(tmp_path, 4)
    assert [each.part for each in observed] == parts[:4]
    for each, settings in zip(observed[::3], built, strict=True):
        part = load_part(each.part)
        assert settings["num_parts"] == with_room(SceneConfig(part=each.part, num_parts=(2, 30))).num_parts
        assert each.signature[0] == part.model.d_max
        assert each.d_max_px == pytest.approx(part.model.d_max * 2400 / 0.9)
        assert each.training == ("family" if parse_name(each.part).family in TRAINING_FAMILIES else "zero-shot")
