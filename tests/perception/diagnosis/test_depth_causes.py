"""Noise and holes of the depth are named where they cost the poses, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from perception.diagnosis import diagnose
from perception.diagnosis.depth_causes import few_found, noise_cause, sparse_cause
from perception.diagnosis.report import PoseCounts
from tests.perception.diagnosis import bin_scene as scene

FEW = PoseCounts(groups=10, found=2, by_score=8)
MANY = PoseCounts(groups=10, found=8, by_score=2)


def noisy(sigma: float, step: float = 0.0) -> NDArray[np.float32]:
    """Return the depth of a tilted plane 0.8 m away with noise, in whole steps if there are any [m]."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:200, :260]
    depth = 0.8 + 0.0004 * u + 0.0003 * v + sigma * rng.normal(size=u.shape)
    return np.asarray(np.rint(depth / step) * step if step else depth, np.float32)


@pytest.mark.parametrize(
    ("sigma", "step", "d_max", "words"),
    [
        (0.004, 0.0, 0.09, "the noise of the depth is 4"),
        (0.0015, 0.0, 0.02, "of the part's extent"),
        (0.0002, 0.005, 0.09, "the depth has steps of 5 mm"),
    ],
)
def test_noise_and_coarse_steps_are_named_where_poses_are_lost(
    sigma: float, step: float, d_max: float, words: str
) -> None:
    (cause,) = noise_cause(noisy(sigma, step), 1.0, d_max, FEW)
    assert cause.name == "depth_noise"
    assert words in cause.text
    assert noise_cause(noisy(sigma, step), 1.0, d_max, MANY) == []
    assert noise_cause(noisy(sigma, step), 1.0, d_max, None) == []


def test_a_quiet_depth_is_no_cause() -> None:
    assert noise_cause(noisy(0.001), 1.0, 0.09, FEW) == []
    assert noise_cause(noisy(0.0003, 0.001), 1.0, 0.09, FEW) == []
    assert sparse_cause(noisy(0.001), FEW) == []


@pytest.mark.parametrize(
    ("rows", "columns", "words"),
    [(2, 1, "1 of every 2 rows are missing"), (1, 3, "2 of every 3 columns are missing")],
)
def test_rows_and_columns_that_are_missing_regularly_are_named(rows: int, columns: int, words: str) -> None:
    depth = np.zeros((200, 260), np.float32)
    depth[::rows, ::columns] = noisy(0.001)[::rows, ::columns]
    (cause,) = sparse_cause(depth, FEW)
    assert cause.name == "sparse_depth"
    assert words in cause.text
    assert sparse_cause(depth, MANY) == []


def test_mostly_missing_depth_is_named_by_its_share() -> None:
    depth = np.where(np.random.default_rng(1).random((200, 260)) < 0.2, noisy(0.001), 0.0).astype(np.float32)
    (cause,) = sparse_cause(depth, FEW)
    assert "only 20 % of the pixels around the bin have a depth: edges and surfaces are lost" in cause.text
    assert sparse_cause(np.zeros((200, 260), np.float32), FEW) == []  # another cause's


def test_without_groups_few_are_found() -> None:
    assert few_found(PoseCounts(groups=0, found=0))
    assert not few_found(None)


@pytest.mark.parametrize("axis", [0, 1])
def test_missing_lines_that_fall_on_the_sampled_pixels_are_not_taken_for_no_depth(axis: int) -> None:
    frame = scene.good()[0]
    depth = np.where(np.indices(frame.depth.shape)[axis] % 2 == 1, frame.depth, 0).astype(np.float32)
    report = diagnose(replace(frame, depth=depth), scene.BIN, scene.ELL, poses=FEW)
    assert [cause.name for cause in report.causes] == ["sparse_depth"]
    assert report.median_depth == pytest.approx(0.58, abs=0.05)
