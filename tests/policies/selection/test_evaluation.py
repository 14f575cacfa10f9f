"""Selectors on the same bins: folders, resumption, the comparison and its table."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from policies.evaluation.cell import Cell
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import FolderError, Job
from policies.evaluation.records import BinRecord
from policies.selection.evaluation import (
    compare_selectors,
    evaluate_selectors,
    save_selector_results,
    selector_cell,
    selector_names,
    selector_table,
)
from policies.selection.hindsight import TRIED, HindsightPicker
from policies.selection.network import SelectorNet, SelectorNetConfig
from policies.selection.weights import save_selector
from tests.policies.fake_cell import dice_cell

CONFIG = EvaluationConfig(perception="oracle", seed=3)


def cell(spec: str, config: EvaluationConfig) -> Cell:
    return dice_cell(config)


def evaluated(
    tmp_path: Path, bins: int = 3, specs: Sequence[str] = ("random", "weighted")
) -> dict[str, list[BinRecord]]:
    job = Job(out=tmp_path, bins=bins)
    return evaluate_selectors(CONFIG, job, specs, make_cell=cell)


def scored(record: BinRecord, delivered: int, total: int = 10) -> BinRecord:
    return replace(record, delivered=delivered, parts_total=total)


def test_every_selector_picks_the_same_bins_into_its_own_folder(tmp_path: Path) -> None:
    told: list[tuple[str, int]] = []
    job = Job(out=tmp_path, bins=2)
    records = evaluate_selectors(
        CONFIG, job, ["random", "weighted"], lambda name, r: told.append((name, r.index)), make_cell=cell
    )
    assert told == [("random", 0), ("random", 1), ("weighted", 0), ("weighted", 1)]
    seeds = {name: [record.seed for record in own] for name, own in records.items()}
    assert seeds["random"] == seeds["weighted"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["random", "weighted"]


def test_bins_that_are_there_are_not_picked_again(tmp_path: Path) -> None:
    evaluated(tmp_path, 2)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("bin_*.json")}
    evaluated(tmp_path, 3, ("random", "weighted", "highest"))
    assert len(before) == 4
    assert all(path.stat().st_mtime_ns == at for path, at in before.items())
    assert len(list(tmp_path.rglob("bin_*.json"))) == 9
    with pytest.raises(FolderError, match="holds another evaluation"):
        evaluate_selectors(replace(CONFIG, sensor="harsh"), Job(out=tmp_path, bins=1), ["random"], make_cell=cell)


def test_a_trained_selectors_name_changes_with_its_file(tmp_path: Path) -> None:
    path = tmp_path / "net.safetensors"
    names = set()
    for hidden in (4, 8):
        save_selector(path, SelectorNet(SelectorNetConfig(hidden=hidden)), {})
        names |= set(selector_names([str(path)]).values())
    assert len(names) == 2
    assert all(name.startswith("net-") for name in names)
    with pytest.raises(ValueError, match="every selector may be evaluated once, got random, random"):
        selector_names(["random", "random"])
    assert selector_names(["hindsight", "random"]) == {"hindsight": "hindsight", "random": "random"}
    with pytest.raises(ValueError, match=r"or the path of a .safetensors file, got 'none'"):
        selector_names(["none"])


def test_the_comparison_is_with_the_best_heuristic_and_paired(tmp_path: Path) -> None:
    base = evaluated(tmp_path, 4, ("random",))["random"]
    records = {
        "random": [scored(r, n) for r, n in zip(base, (1, 5, 2, 4), strict=True)],
        "weighted": [scored(r, n) for r, n in zip(base, (4, 8, 5, 7), strict=True)],
        "ours-1": [scored(r, n) for r, n in zip(base, (5, 9, 6, 8), strict=True)],  # one more in every bin
    }
    best, results = compare_selectors(records)
    assert best == "weighted"
    assert results["weighted"].dr_gap is None
    assert results["ours-1"].dr_gap == pytest.approx((0.1, 0.1, 0.1))
    assert results["random"].dr_gap == pytest.approx((-0.3, -0.3, -0.3))
    assert results["ours-1"].gsr_gap == pytest.approx((0.0, 0.0, 0.0))
    assert results["ours-1"].dr.value == pytest.approx(0.7)
    text = selector_table(best, results)
    assert [line.split()[0] for line in text.splitlines()[1:4]] == ["ours-1", "weighted", "random"]
    assert "+10.0 (+10.0 to +10.0)" in text
    save_selector_results(tmp_path / "s.json", CONFIG, best, results, records)
    kept = json.loads((tmp_path / "s.json").read_text())
    assert kept["best_heuristic"] == "weighted"
    assert kept["selectors"]["ours-1"]["dr_gap"] == pytest.approx([0.1, 0.1, 0.1])
    assert kept["selectors"]["weighted"]["dr_gap"] is None


def with_tries(record: BinRecord, *tries: int) -> BinRecord:
    """Let the first attempts of a bin have been kept from so many, the others from one each."""
    counts = [*tries, *[1] * len(record.picks)]
    picks = [replace(pick, features={TRIED: float(n)}) for pick, n in zip(record.picks, counts, strict=False)]
    return replace(record, picks=tuple(picks))


def test_hindsight_is_a_bound_and_no_heuristic(tmp_path: Path) -> None:
    base = evaluated(tmp_path, 3, ("random", "hindsight"))
    records = {
        "random": [scored(r, n) for r, n in zip(base["random"], (2, 3, 4), strict=True)],
        "weighted": [scored(r, n) for r, n in zip(base["random"], (4, 5, 6), strict=True)],
        "ours-1": [scored(r, n) for r, n in zip(base["random"], (5, 6, 7), strict=True)],
        "hindsight": [scored(with_tries(r, 1, 3), n) for r, n in zip(base["hindsight"], (8, 9, 10), strict=True)],
    }
    best, results = compare_selectors(records)
    assert best == "weighted"
    reached = {name: own.reached for name, own in results.items()}
    assert reached == pytest.approx({"random": -0.5, "weighted": 0.0, "ours-1": 0.25, "hindsight": 1.0})
    tally = results["hindsight"].tally
    assert tally is not None
    attempts = [record.attempts for record in records["hindsight"]]
    assert tally.tries == sum(len(own) for own in attempts) + 2 * 3
    text = selector_table(best, results)
    lines = {line.split()[0]: line for line in text.splitlines()}
    assert lines["selector"].endswith("of the bound")
    assert lines["hindsight"].startswith("hindsight (bound)")
    assert [lines[name].split()[-2:] for name in ("ours-1", "random")] == [["25", "%"], ["-50", "%"]]
    assert text.endswith(str(tally))
    save_selector_results(tmp_path / "s.json", CONFIG, best, results, records)
    kept = json.loads((tmp_path / "s.json").read_text())
    assert kept["best_heuristic"] == "weighted"
    assert kept["selectors"]["ours-1"]["reached"] == pytest.approx(0.25)
    assert kept["hindsight"] == asdict(tally)


def test_without_a_gain_there_is_no_share(tmp_path: Path) -> None:
    own = evaluated(tmp_path, 2, ("random",))["random"]
    for gained in ((8, 8), (10, 8), (10, 7)):  # nothing, or what chance may have gained
        seen = [scored(with_tries(r), n) for r, n in zip(own, gained, strict=True)]
        best, results = compare_selectors({"random": [scored(r, 8) for r in own], "hindsight": seen})
        assert [each.reached for each in results.values()] == [None, None]
        rows = selector_table(best, results).splitlines()[1:3]
        assert not any(row.rstrip().endswith("%") for row in rows)
    best, results = compare_selectors({"random": own})
    assert results["random"].reached is None
    assert "bound" not in selector_table(best, results)
    with pytest.raises(ValueError, match="a heuristic is needed to compare with"):
        compare_selectors({"hindsight": [with_tries(r) for r in own]})


@pytest.mark.slow
def test_hindsights_bins_are_kept_with_their_tries(tmp_path: Path) -> None:
    """Picked in the real cell, and read back from its folder."""
    config = EvaluationConfig(perception="oracle", seed=31, num_parts=(1, 1), bin=(0.3, 0.2, 0.1))
    job = Job(out=tmp_path, bins=1)
    made: list[Cell] = []

    def real(spec: str, config: EvaluationConfig) -> Cell:
        made.append(selector_cell(spec, config))
        return made[-1]

    (record,) = evaluate_selectors(config, job, ["hindsight"], make_cell=real)["hindsight"]
    assert isinstance(made[0].picker, HindsightPicker)
    assert made[0].env.workspace.inner_size.tolist() == [0.3, 0.2, 0.1]
    assert [pick.features[TRIED] for pick in record.attempts] == [1.0]
    assert evaluate_selectors(config, job, ["hindsight"], make_cell=real)["hindsight"] == [record]
    assert len(made) == 1


def test_selectors_that_cannot_be_compared_are_refused(tmp_path: Path) -> None:
    own = evaluated(tmp_path, 2, ("random",))["random"]
    with pytest.raises(ValueError, match="a heuristic is needed to compare with: one of random, highest"):
        compare_selectors({"ours": own})
    with pytest.raises(ValueError, match="were not evaluated on the same bins"):
        compare_selectors({"ours": own, "random": own[:1]})
    assert np.isnan(compare_selectors({"ours": own[:1], "random": own[:1]})[1]["ours"].dr_gap[1])  # type: ignore[index]
