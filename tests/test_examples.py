"""Every example runs on tiny settings, and what it returns is right."""

import importlib.util
import math
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def load(number: str) -> ModuleType:
    (path,) = (path for path in EXAMPLES if path.name.startswith(number))
    spec = importlib.util.spec_from_file_location(f"example_{number}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_is_listed_and_tested() -> None:
    listed = (ROOT / "examples" / "README.md").read_text(encoding="utf-8")
    tests = Path(__file__).read_text(encoding="utf-8")
    assert len(EXAMPLES) == 10
    for path in EXAMPLES:
        assert f"`{path.name}`" in listed
        assert f'load("{path.name[:2]}")' in tests


def test_01_offers_the_parts() -> None:
    assert load("01").main(num_parts=3, steps=2) == 3


@pytest.mark.slow
def test_02_empties_a_bin() -> None:
    result = load("02").main(num_parts=2)
    assert (result.delivered, result.parts_total, result.termination) == (2, 2, "empty")


@pytest.mark.slow
def test_03_reads_a_pin(tmp_path: Path) -> None:
    part = load("03").main(tmp_path)
    volume = 1.5 * math.sqrt(3) * 0.012**2 * 0.06  # of a hexagonal prism [m^3]
    assert part.unit == "mm"
    assert part.mass == pytest.approx(7850 * volume, rel=1e-6)
    assert len(part.model.symmetry.rotations) == 12


def test_04_draws_the_boundary(tmp_path: Path) -> None:
    boundary = load("04").main(tmp_path, num_parts=3)
    assert len(boundary) > 1000
    grey, drawn = cv2.imread(str(tmp_path / "grey.png")), cv2.imread(str(tmp_path / "boundary.png"))
    assert np.count_nonzero((grey != drawn).any(axis=2)) > 0.9 * len(boundary)


@pytest.mark.slow
def test_05_separates_the_parts() -> None:
    instances, ap50 = load("05").main(num_parts=4)
    assert len(instances) >= 4
    assert ap50 > 0.9


@pytest.mark.slow
def test_06_finds_the_poses() -> None:
    errors = load("06").main(num_parts=3)
    assert len(errors) >= 2
    assert max(errors) < 0.001


@pytest.mark.slow
def test_07_changes_the_cell() -> None:
    shares = load("07").main(num_parts=2)
    assert shares["harsh sensor"] < shares["standard"]
    assert shares["camera at 1.2 m, 10 mm off"] < shares["standard"]
    assert shares["jaw of 60 mm"] == shares["standard"]


@pytest.mark.slow
def test_08_delivers() -> None:
    assert load("08").main(num_parts=2, decisions=1) == ["delivered"]


@pytest.mark.slow
def test_09_trains_a_selector(tmp_path: Path) -> None:
    path, fit = load("09").main(tmp_path, bins=1, num_parts=2)
    assert path.is_file()
    assert math.isfinite(fit.loss)


@pytest.mark.slow
def test_10_finds_poses_in_arrays(tmp_path: Path) -> None:
    example = load("10")
    example.record(tmp_path / "frame.npz")
    poses = example.main(tmp_path / "frame.npz")
    assert len(poses) >= 4
    assert min(pose.score for pose in poses) >= 0.9
