"""The selector's network: order and empty rows do not matter; its file; the selector made of it."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from policies.selection.candidate_generator import ROWS
from policies.selection.features import FEATURES, column
from policies.selection.network import SelectorNet, SelectorNetConfig
from policies.selection.selectors import LearnedSelector, WeightedSelector, load_selector, selector_path
from policies.selection.weights import SelectorError, load_selector_net, load_selector_record, save_selector

CONFIGS = [
    SelectorNetConfig(),
    SelectorNetConfig(hidden=16, context=False),
    SelectorNetConfig(hidden=0),
]


def observations(count: int = 4, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    rows = torch.rand((count, ROWS, len(FEATURES)), generator=generator)
    mask = torch.rand((count, ROWS), generator=generator) < 0.6
    return rows, mask


@pytest.mark.parametrize("config", CONFIGS, ids=["full", "rows alone", "logistic"])
def test_another_order_of_rows_reorders_the_logits_only(config: SelectorNetConfig) -> None:
    network = SelectorNet(config)
    rows, mask = observations()
    order = torch.randperm(ROWS, generator=torch.Generator().manual_seed(1))
    logits, value = network(rows, mask)
    reordered, same = network(rows[:, order], mask[:, order])
    torch.testing.assert_close(reordered, logits[:, order])
    torch.testing.assert_close(same, value)


@pytest.mark.parametrize("config", CONFIGS, ids=["full", "rows alone", "logistic"])
def test_what_empty_rows_hold_says_nothing(config: SelectorNetConfig) -> None:
    network = SelectorNet(config)
    rows, mask = observations()
    other = rows.masked_fill(~mask[..., None], 1e6)
    for one, two in zip(network(rows, mask), network(other, mask), strict=True):
        torch.testing.assert_close(one, two)
    assert network(rows, mask)[0][~mask].max() < -1e7


def test_no_candidate_has_a_finite_value() -> None:
    rows, mask = observations()
    logits, value = SelectorNet()(rows, torch.zeros_like(mask))
    assert torch.isfinite(value).all()
    assert torch.isfinite(logits).all()


def test_context_counts_only_where_it_is_asked_for() -> None:
    rows, mask = observations(1)
    mask[:] = True
    other = rows.clone()
    other[:, 1:] = 1 - other[:, 1:]
    for config, moves in ((CONFIGS[0], True), (CONFIGS[1], False)):
        torch.manual_seed(0)
        network = SelectorNet(config)
        gap = (network(rows, mask)[0][0, 0] - network(other, mask)[0][0, 0]).abs().item()
        assert (gap > 1e-6) is moves


def test_logistic_regression_is_a_weighted_sum() -> None:
    network = SelectorNet(SelectorNetConfig(hidden=0))
    rows, mask = observations(1)
    weights = {name: value for name, value in network.named_parameters() if name.startswith("score")}
    expected = rows[0] @ weights["score.weight"][0] + weights["score.bias"]
    torch.testing.assert_close(network(rows, mask)[0][0][mask[0]], expected[mask[0]])


def test_columns_are_taken_by_name(tmp_path: Path) -> None:
    names = "top", "quality"
    network = SelectorNet(SelectorNetConfig(features=names, hidden=0))
    rows, mask = observations(1)
    expected = rows[0][:, [column(name) for name in names]] @ network.score.weight[0] + network.score.bias  # type: ignore[operator, union-attr, index]
    torch.testing.assert_close(network(rows, mask)[0][0][mask[0]], expected[mask[0]])
    save_selector(tmp_path / "a.safetensors", network, {})
    for one, two in zip(network(rows, mask), load_selector_net(tmp_path / "a.safetensors")(rows, mask), strict=True):
        torch.testing.assert_close(one, two, rtol=0, atol=0)


def test_a_selector_survives_its_file(tmp_path: Path) -> None:
    network = SelectorNet(SelectorNetConfig(hidden=8))
    save_selector(tmp_path / "a.safetensors", network, {"method": "by hand"})
    loaded = load_selector_net(tmp_path / "a.safetensors")
    rows, mask = observations()
    for one, two in zip(network(rows, mask), loaded(rows, mask), strict=True):
        torch.testing.assert_close(one, two, rtol=0, atol=0)
    assert load_selector_record(tmp_path / "a.safetensors")["method"] == "by hand"
    assert json.loads((tmp_path / "a.json").read_text())["network"]["hidden"] == 8


def test_files_of_something_else_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    with pytest.raises(SelectorError, match="does not hold a complete selector"):
        load_selector_net(path)
    save_selector(path, SelectorNet(), {"network": {"features": ["x", "colour"]}})
    with pytest.raises(SelectorError, match="it was trained on features that do not exist: colour"):
        load_selector_net(path)
    save_selector(path, SelectorNet(), {"network": {"features": list(FEATURES), "hidden": 3}})
    with pytest.raises(SelectorError, match=r"needs a tensor of \(3,\) for rows.0.bias, it holds a tensor of"):
        load_selector_net(path)
    save_selector(path, SelectorNet(), {"version": 7})
    with pytest.raises(SelectorError, match="is a selector of version 7, this code reads 1"):
        load_selector_net(path)


def test_a_learned_selector_takes_its_best_valid_row(tmp_path: Path) -> None:
    network = SelectorNet(SelectorNetConfig(hidden=0))
    with torch.no_grad():
        network.score.weight.zero_()  # type: ignore[operator, union-attr]
        network.score.weight[0, column("height")] = 2.0  # type: ignore[index, union-attr]
    save_selector(tmp_path / "high.safetensors", network, {})
    selector = load_selector(str(tmp_path / "high.safetensors"))
    assert isinstance(selector, LearnedSelector)
    grasps, mask = np.zeros((ROWS, len(FEATURES)), np.float32), np.zeros(ROWS, np.int8)
    grasps[:, column("height")] = np.linspace(0, 1, ROWS)
    mask[3:7] = 1
    assert selector.select({"grasps": grasps, "mask": mask}, np.random.default_rng(0)) == 6


def test_selectors_are_found_by_name_or_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(load_selector("weighted"), WeightedSelector)
    monkeypatch.setattr("policies.selection.selectors.SHIPPED", tmp_path)
    save_selector(tmp_path / "ours.safetensors", SelectorNet(), {})
    assert selector_path("ours") == tmp_path / "ours.safetensors"
    assert isinstance(load_selector("ours"), LearnedSelector)
    with pytest.raises(ValueError, match=r"random, .*, ours, or the path of a .safetensors file, got 'x'"):
        load_selector("x")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"features": ()}, "features must name at least one column"),
        ({"features": ("colour",)}, "there is no feature 'colour'"),
        ({"hidden": -1}, "hidden must not be negative, got -1"),
    ],
)
def test_nonsense_is_refused(change: dict[str, int], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        SelectorNetConfig(**change)  # type: ignore[arg-type]
