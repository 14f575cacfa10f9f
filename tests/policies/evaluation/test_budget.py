"""What each stage of perception costs, worked by hand, and how it is printed."""

import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

from binpick_env.config import Perception
from policies.evaluation.budget import MODES, Budget, Runs, budget_jobs, make_budget
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job, run_job
from policies.evaluation.records import BinRecord
from policies.evaluation.summary import summarise
from policies.grasping.outcomes import GraspOutcome, PickResult
from policies.report.budget_report import budget_table, write_budget_report
from policies.report.conclusion import conclude, conclude_budget
from tests.policies.fake_cell import abstain, attempt, bin_result, dice_cell

pytestmark = pytest.mark.slow

CONFIG = EvaluationConfig(seed=31, num_parts=(6, 6))
DELIVERED, MISSED = GraspOutcome.DELIVERED, GraspOutcome.MISSED
# Attempts take 6 s. GSR 4/4, 3/4, 1/4 and DR 4/20, 3/20, 1/20, in two bins of 10 parts.
PICKS: dict[Perception, list[list[PickResult]]] = {
    "oracle": [[attempt(DELIVERED)] * 3, [attempt(DELIVERED)]],
    "gt_masks": [[attempt(DELIVERED)] * 2 + [attempt(MISSED)], [attempt(DELIVERED)]],
    "learned": [[attempt(DELIVERED), attempt(MISSED), attempt(MISSED)], [attempt(MISSED)]],
}


def runs(out: Path) -> Runs:
    return budget_jobs(CONFIG, Job(out=out, bins=2))


def made(out: Path, picks: dict[Perception, list[list[PickResult]]] = PICKS) -> dict[Perception, list[BinRecord]]:
    records: dict[Perception, list[BinRecord]] = {}
    for mode, (config, _) in runs(out).items():
        facts: dict[str, Any] = {"config_hash": config.digest(), "wall": 9.0, "settle": 1.0, "render": 1.0}
        records[mode] = [
            BinRecord.from_result(bin_result(*bin_, seed=k), [""] * len(bin_), index=k, **facts)
            for k, bin_ in enumerate(picks[mode])
        ]
    return records


def budget_of(out: Path, picks: dict[Perception, list[list[PickResult]]] = PICKS) -> Budget:
    records = made(out, picks)
    modes = {mode: summarise(records[mode], run[0], np.random.default_rng(0)) for mode, run in runs(out).items()}
    return make_budget(records, modes, np.random.default_rng(0))


def test_each_perception_has_its_own_folder_and_the_same_bins(tmp_path: Path) -> None:
    jobs = runs(tmp_path)
    assert list(jobs) == ["oracle", "gt_masks", "learned"]
    for mode, (config, job) in jobs.items():
        assert (config.perception, config.seed, job.out, job.bins) == (mode, 31, tmp_path / mode, 2)


def test_a_cost_is_the_difference_of_the_printed_numbers(tmp_path: Path) -> None:
    budget = budget_of(tmp_path)
    assert (budget.modes["oracle"].gsr, budget.modes["gt_masks"].gsr, budget.modes["learned"].gsr) == (1.0, 0.75, 0.25)
    gsr = {stage: budget.costs[stage]["gsr"].value for stage in budget.costs}
    assert gsr == pytest.approx({"pose": 0.25, "segmentation": 0.5, "both": 0.75})
    dr = {stage: budget.costs[stage]["dr"].value for stage in budget.costs}
    assert dr == pytest.approx({"pose": 0.05, "segmentation": 0.1, "both": 0.15})
    mpph = {stage: budget.costs[stage]["mpph"].value for stage in budget.costs}
    assert mpph == pytest.approx({"pose": 150.0, "segmentation": 300.0, "both": 450.0})


def test_the_interval_draws_each_bin_under_both_conditions(tmp_path: Path) -> None:
    # Of two bins every fourth draw is one of them twice: a third lost of 3 attempts in the first, all in the second.
    cost = budget_of(tmp_path).costs["segmentation"]["gsr"]
    assert (cost.low, cost.high) == pytest.approx((1 / 3, 1.0))


def test_what_does_not_exist_has_no_cost(tmp_path: Path) -> None:
    budget = budget_of(tmp_path, PICKS | {"learned": [[abstain()], [abstain()]]})
    assert budget.costs["segmentation"]["gsr"].value is None
    assert budget.costs["segmentation"]["dr"].value == 0.15
    assert "–" in budget_table(budget)
    single = budget_of(tmp_path, {mode: bins[:1] for mode, bins in PICKS.items()})
    assert (single.costs["both"]["dr"].value, single.costs["both"]["dr"].low) == (pytest.approx(0.2), None)
    assert "DR [points]" in budget_table(single)


def test_other_bins_are_not_compared(tmp_path: Path) -> None:
    records = made(tmp_path)
    modes = {mode: summarise(records[mode], run[0], np.random.default_rng(0)) for mode, run in runs(tmp_path).items()}
    records["gt_masks"] = records["gt_masks"][:1]
    with pytest.raises(ValueError, match="the bins must be the same in oracle, gt_masks, learned, but their seeds"):
        make_budget(records, modes, np.random.default_rng(0))


def test_the_table_shows_three_evaluations_and_their_differences(tmp_path: Path) -> None:
    table = budget_table(budget_of(tmp_path))
    rows = {line.split("  ")[0]: line.split() for line in table.splitlines() if line}
    assert rows["GSR"][1:] == ["100.0", "%", "75.0", "%", "25.0", "%"]
    assert rows["GSR [points]"][2] == "+25.0"
    assert rows["concurrent [s]"][2:] == ["0.00"] * 3
    assert rows["overlapped"][1:] == ["600", "450", "150"]
    assert "segmentation (gt_masks - learned)" in table
    assert "tee · sensor good · 2 bins · seed 31" in table
    assert max(map(len, table.splitlines())) <= 130


class Links(HTMLParser):
    """Collects the links of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value or "" for name, value in attrs if name == "href"]


def test_the_page_links_to_each_evaluation(tmp_path: Path) -> None:
    write_budget_report(tmp_path / "budget.html", budget_of(tmp_path))
    text = (tmp_path / "budget.html").read_text()
    assert Links(text).found == [f"{mode}/report.html" for mode in MODES]
    assert "+25.0 (" in text


def test_a_job_ends_in_numbers_a_page_and_a_text(tmp_path: Path) -> None:
    for html in (True, False):
        job = Job(out=tmp_path / str(html), bins=2)
        records = run_job(CONFIG, job, make_cell=dice_cell)
        text = conclude(records, CONFIG, job, html=html)
        assert (job.out / "report.html").exists() == html
        assert json.loads((job.out / "results.json").read_text())["bins"] == 2
        assert text.splitlines()[-2 - html] == f"numbers   {job.out / 'results.json'}"
        assert text.splitlines()[-1] == f"picks     {job.out / 'picks.csv'}"
        assert len((job.out / "picks.csv").read_text().splitlines()) == 1 + sum(len(r.picks) for r in records)
    text = conclude(records, CONFIG, job, numbers=tmp_path / "n.json", html=False)
    assert f"numbers   {tmp_path / 'n.json'}" in text.splitlines()
    assert (tmp_path / "n.json").exists()
    text = conclude(records, CONFIG, job, archive=True)
    assert text.endswith(f"archive   {job.out / 'report.zip'}")
    assert set(ZipFile(job.out / "report.zip").namelist()) == {"report.html", "picks.csv", "results.json"}


def test_a_budget_ends_in_numbers_pages_and_a_text(tmp_path: Path) -> None:
    job = Job(out=tmp_path, bins=2)
    jobs = budget_jobs(CONFIG, job)
    records = {mode: run_job(*run, make_cell=dice_cell) for mode, run in jobs.items()}
    text = conclude_budget(records, jobs, job)
    assert text.splitlines()[-2:] == [f"numbers   {tmp_path / 'budget.json'}", f"report    {tmp_path / 'budget.html'}"]
    values = json.loads((tmp_path / "budget.json").read_text())
    assert values["costs"]["pose"]["gsr"] == {"value": 0.0, "low": 0.0, "high": 0.0}  # the dice ignore perception
    assert list(values["modes"]) == list(MODES)
    oracle = values["modes"]["oracle"]
    assert oracle["failure_attribution"] == oracle["blame"]  # the previous name, for one version
    for mode in MODES:
        assert (tmp_path / mode / "report.html").exists()
        assert json.loads((tmp_path / mode / "results.json").read_text())["config"]["perception"] == mode
    conclude_budget(records, jobs, job, archive=True)
    packed = {f"{mode}/{name}" for mode in MODES for name in ("report.html", "picks.csv")}
    assert set(ZipFile(tmp_path / "report.zip").namelist()) == packed | {"budget.html", "budget.json"}
    text = conclude_budget(records, jobs, job, numbers=tmp_path / "n.json", html=False)
    assert text.endswith(f"numbers   {tmp_path / 'n.json'}")
    assert (tmp_path / "n.json").exists()
