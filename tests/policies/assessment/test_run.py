"""Assessments of small parts from end to end, with one scene of two parts."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
import trimesh

from binpick_env.cell.protective_stop import ProtectiveStop
from binpick_env.cell.settle import SettleError
from binpick_env.options import CellOptions
from perception.segmentation import weights
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.weights import GENERAL, save_network
from policies.assessment import advice
from policies.assessment import run as assessment_run
from policies.assessment.assessment import save_assessment
from policies.assessment.config import AssessmentConfig
from policies.assessment.run import AssessmentJob, AssessmentRun, Progress, assess
from policies.report.assessment_report import write_assessment_report
from policies.report.assessment_text import assessment_lines

pytestmark = pytest.mark.slow


class Told(Progress):
    """Collects what it is told."""

    def __init__(self) -> None:
        self.stages: list[tuple[str, int]] = []
        self.steps: dict[str, int] = {}

    def begin(self, stage: str, total: int) -> None:
        self.stages.append((stage, total))
        self.steps[stage] = 0

    def advance(self) -> None:
        self.steps[self.stages[-1][0]] += 1


def assessed(folder: Path, sides: tuple[float, float, float], progress: Progress, **options: object) -> AssessmentRun:
    """Assess a block of these sides [mm] on one scene and one bin of two parts."""
    trimesh.creation.box(sides).export(folder / "block.stl")
    cell = CellOptions(**{"part": str(folder / "block.stl"), "unit": "mm", "sensor": "none", **options})  # type: ignore[arg-type]
    config = AssessmentConfig(options=cell, seed=31, scenes=1, bins=1, num_parts=(2, 2))
    return assess(config, AssessmentJob(out=folder / "out", workers=1, progress=progress))


def test_a_part_that_cannot_be_held_is_assessed_for_perception(tmp_path: Path) -> None:
    told = Told()
    run = assessed(tmp_path, (120, 105, 90), told)
    findings = run.assessment.findings
    assert told.stages == [("part", 4), ("scenes", 1)]
    assert told.steps == {"part": 4, "scenes": 1}
    assert findings.perception is not None
    assert findings.perception.recognition > 0.5
    assert (findings.picking, run.records, run.assessment.budget) == (None, {}, None)
    assert findings.not_picked == findings.grip.reason
    assert [piece.kind for piece in run.assessment.advice] == ["jaw"]
    lines = assessment_lines(run.assessment, tmp_path / "numbers.json")
    assert any(line.startswith("picks      not run: the jaw (stroke 85 mm) finds no grasp") for line in lines)
    write_assessment_report(tmp_path / "report.html", run, tmp_path / "out")
    page = (tmp_path / "report.html").read_text()
    assert "Picks were not run: the jaw (stroke 85 mm) finds no grasp" in page
    assert "<h3>Scene 0" in page
    save_assessment(tmp_path / "numbers.json", run.assessment)


def test_a_bin_that_the_part_does_not_fit_into_leaves_the_part_and_the_advice(tmp_path: Path) -> None:
    told = Told()
    run = assessed(tmp_path, (150, 40, 25), told, bin=(0.08, 0.08, 0.08))
    findings = run.assessment.findings
    assert told.stages == [("part", 4)]
    assert findings.perception is None
    assert findings.picking is None
    assert "no pile of larger ones lies in a bin of 80 x 80 x 80 mm), got 0.1572 m" in (findings.not_perceived or "")
    assert findings.not_picked == findings.not_perceived
    assert [piece.kind for piece in run.assessment.advice] == ["bin"]
    write_assessment_report(tmp_path / "report.html", run, tmp_path / "out")
    assert "Perception was not run" in (tmp_path / "report.html").read_text()


def test_a_pile_that_does_not_come_to_rest_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object, **__: object) -> Iterator[int]:
        yield from ()
        raise SettleError("2 parts do not come to rest")

    monkeypatch.setattr(assessment_run, "evaluate_poses", never)
    findings = assessed(tmp_path, (80, 40, 25), Told()).assessment.findings
    assert findings.not_perceived == findings.not_picked == "2 parts do not come to rest"


def test_a_part_that_the_network_does_not_separate_needs_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(weights, "user_folder", lambda: tmp_path / "weights")
    torch.manual_seed(0)
    network = GridNet(GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=4))
    save_network(tmp_path / "weights" / f"{GENERAL}.safetensors", network, {"parts": [], "general": True, "shapes": {}})
    run = assessed(tmp_path, (80, 40, 25), Told())
    findings = run.assessment.findings
    assert findings.perception is not None
    assert findings.perception.ap < 0.8
    assert findings.perception.training == "zero-shot"
    (piece,) = run.assessment.advice
    assert piece.kind == "train"
    assert f"binpick train-segmentation --part {tmp_path / 'block.stl'} --unit mm --minutes 30" in piece.text
    assert findings.picking is not None
    assert findings.picking.dr["oracle"] == 1.0
    assert findings.picking.losses.segmentation > 0
    assert findings.picking.losses.largest() == "segmentation"


def test_a_cube_in_a_narrow_bin_needs_another_bin(tmp_path: Path) -> None:
    run = assessed(tmp_path, (50, 50, 50), Told(), bin=(0.12, 0.115, 0.2))
    picking = run.assessment.findings.picking
    assert picking is not None
    assert picking.left.get("no_clear_approach", 0) + picking.left.get("ik_infeasible", 0) >= 1
    assert [piece.kind for piece in run.assessment.advice] == ["bin"]
    assert "because walls and neighbours block the fingers" in run.assessment.advice[0].because


def test_a_part_that_slips_needs_another_jaw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It weighs twice what a UR5e may carry; the arm here carries it, and does not stop before the part slips."""
    monkeypatch.setattr(advice, "PAYLOAD", 20.0)
    monkeypatch.setattr(ProtectiveStop, "trips", lambda _: False)
    run = assessed(tmp_path, (120, 70, 70), Told(), density=19000.0)
    picking = run.assessment.findings.picking
    assert picking is not None
    assert picking.failed >= 1
    assert [piece.kind for piece in run.assessment.advice] == ["jaw"]
    assert "; the part weighs 11172 g" in run.assessment.advice[0].because
