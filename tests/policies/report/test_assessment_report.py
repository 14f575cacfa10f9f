"""The page and the lines of an assessment, from findings made by hand and records of a cell without physics."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binpick_env.parts import load_part
from policies.assessment.advice import Advice, advise
from policies.assessment.assessment import Assessment, save_assessment
from policies.assessment.findings import Findings
from policies.assessment.resting import resting_poses
from policies.assessment.run import AssessmentRun
from policies.evaluation.budget import budget_jobs, make_budget
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job, run_job
from policies.evaluation.summary import summarise
from policies.report.assessment_report import write_assessment_report
from policies.report.assessment_text import assessment_lines
from tests.policies.assessment.findings_of import FINE, changed
from tests.policies.fake_cell import dice_cell
from tests.policies.report.test_report import Page


def run_of(folder: Path, findings: Findings = FINE, advice: tuple[Advice, ...] | None = None) -> AssessmentRun:
    """Return an assessment of a bracket with two bins, whose picks are by dice."""
    part = load_part("bracket")
    rests = resting_poses(part.model)
    grip = replace(findings.grip, at_rest=tuple(range(len(rests))))
    findings = replace(findings, rests=rests, grip=grip)
    jobs = budget_jobs(EvaluationConfig(part="bracket", num_parts=(3, 3)), Job(out=folder / "picks", bins=2))
    records = {mode: run_job(*job, make_cell=dice_cell) for mode, job in jobs.items()}
    modes = {mode: summarise(records[mode], job[0], np.random.default_rng(0)) for mode, job in jobs.items()}
    assessment = Assessment(
        findings=findings,
        advice=advise(findings) if advice is None else advice,
        budget=make_budget(records, modes, np.random.default_rng(0)),
        seed=7,
        seconds={"part": 2.0, "scenes": 30.25, "bins": 60.0},
    )
    return AssessmentRun(assessment=assessment, part=part, scores=(), records=records)


def written(folder: Path, **changes: Any) -> str:
    write_assessment_report(folder / "report.html", run_of(folder, **changes), folder)
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_page_has_every_section_and_all_pictures_inside(tmp_path: Path) -> None:
    text = written(tmp_path)
    page = Page(text)
    assert page.open == []
    assert len(set(page.ids)) == len(page.ids)
    heads = re.findall(r"<h2>(.*?)</h2>", text)
    assert heads[:4] == ["What to do", "Where it is lost", "What was measured", "How it rests and is held"]
    assert {"The same bins three ways", "What each stage costs", "Parts lost or left", "Picks"} <= set(heads)
    assert len(page.pictures) == 5
    assert all(source.startswith("data:image/png;base64,") for source in page.pictures)
    assert page.alts[0] == (
        "bracket at rest, seen from above at an angle: 29 % of drops, 50 mm high, no grasps off the floor"
    )
    assert "Nothing was found that should be changed." in text
    assert "src='http" not in text


@pytest.mark.slow
def test_advice_is_shown_with_its_commands_as_code(tmp_path: Path) -> None:
    text = written(tmp_path, findings=changed("perception", ap=0.4))
    assert "Train the segmentation on the part: <code>binpick train-segmentation --part clip.stl" in text
    assert "Because the AP of general.safetensors (zero-shot) is 40 %" in text


@pytest.mark.slow
def test_names_are_escaped(tmp_path: Path) -> None:
    text = written(tmp_path, findings=changed("part", name="odd <&> name", source="/x/odd <&> name.stl"))
    assert "odd <&> name" not in text
    assert "<h1>Assessment: odd &lt;&amp;&gt; name</h1>" in text


@pytest.mark.slow
def test_what_was_not_run_is_said(tmp_path: Path) -> None:
    findings = replace(FINE, perception=None, picking=None, not_perceived="no rest", not_picked="no grasp")
    run = run_of(tmp_path, findings)
    bare = replace(run, assessment=replace(run.assessment, budget=None), records={})
    write_assessment_report(tmp_path / "report.html", bare, tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Perception was not run: no rest." in text
    assert "Picks were not run: no grasp." in text
    assert "<h2>Picks</h2>" not in text
    lines = assessment_lines(bare.assessment, Path("n.json"))
    assert "scenes     not run: no rest" in lines
    assert "picks      not run: no grasp" in lines


@pytest.mark.slow
def test_a_dozen_lines_end_with_the_advice(tmp_path: Path) -> None:
    run = run_of(tmp_path, changed("grip", graspable_share=0.2))
    lines = assessment_lines(run.assessment, Path("n.json"))
    assert [line.split()[0] for line in lines[:9]] == [
        "part", "rests", "seen", "grasps", "scenes", "picks", "lost", "time", "numbers",
    ]  # fmt: skip
    assert len(lines) == 11
    assert lines[0] == "part       read as mm (given), 70 x 30 x 20 mm, 60 g, symmetry none, 1 body, no repairs"
    assert "AP 95.0 % (general.safetensors, zero-shot), recognition 98.0 %" in lines[4]
    assert lines[7] == "time       part 2 s, scenes 30 s, bins 60 s; together 92 s"
    assert lines[9].startswith("advice     Use another jaw")
    assert lines[10].startswith("           because 80 % of drops")
    fine = assessment_lines(run_of(tmp_path).assessment, Path("n.json"))
    assert fine[-1] == "advice     nothing to change"


def test_all_numbers_are_json_and_an_infinite_width_is_null(tmp_path: Path) -> None:
    import json

    findings = changed("grip", least_width=float("inf"), grasps=0, widths=None, reason="no faces")
    save_assessment(tmp_path / "n.json", run_of(tmp_path, findings).assessment)
    values = json.loads((tmp_path / "n.json").read_text(encoding="utf-8"))
    assert values["grip"]["least_width"] is None
    assert values["advice"][0]["kind"] == "jaw"
    assert values["perception"]["ap"] == 0.95
    assert values["picking"]["losses"]["segmentation"] == 0.01
    assert values["budget"]["bins"] == 2
    assert values["seconds"] == {"part": 2.0, "scenes": 30.25, "bins": 60.0}
    assert {"options", "part", "rests", "sight", "bin", "seed", "command", "git_commit", "versions"} <= set(values)


@pytest.mark.slow
@pytest.mark.parametrize("width", [400, 1200])
def test_the_page_is_as_wide_as_the_window(tmp_path: Path, browser: Any, width: int) -> None:
    findings = replace(changed("perception", ap=0.4), part=changed("part", source="/a/" + 30 * "long_name").part)
    written(tmp_path, findings=findings)
    opened = browser.new_page(viewport={"width": width, "height": 900})
    opened.goto((tmp_path / "report.html").as_uri())
    assert opened.evaluate("document.documentElement.scrollWidth") == width
