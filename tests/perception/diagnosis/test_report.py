"""The text of a report, what its parts refuse, and the log."""

import logging

import numpy as np
import pytest
import trimesh

from perception.boundary import extract_boundary
from perception.diagnosis import Cause, FrameReport, PoseCounts, causes_unlogged, diagnose, log, log_causes
from perception.geometry import make_transform, random_rotation
from perception.part import PartModel
from perception.thickness import part_thickness
from tests.perception.diagnosis import bin_scene as scene

GOOD = scene.good()[0]
CAUSES = Cause(name="few_pixels", text="a part is too small"), Cause(name="underexposed", text="too dark")
REPORT = FrameReport(
    pixels=1000,
    depth_share=0.5,
    median_depth=0.61234,
    boundary_points=120,
    outside=7,
    part_pixels=33.4,
    poses=PoseCounts(groups=9, found=1, by_floor=2, by_walls=1, by_neighbours=1, by_score=3, without_pose=1),
    causes=CAUSES,
)


def test_a_report_is_a_short_text() -> None:
    assert str(REPORT).split("\n") == [
        "bin in the image: 1000 pixels, 50.0 % with depth, median depth 0.6123 m",
        "boundary points: 120 in the bin, 7 edge points outside its box",
        "a part is about 33 pixels long",
        "poses: 1 of 9 groups; rejected: 2 by the floor, 1 by the walls, 1 by neighbours, 3 by score; 1 without a pose",
        "likely cause: a part is too small",
        "likely cause: too dark",
    ]
    bare = FrameReport(
        pixels=0,
        depth_share=0.0,
        median_depth=None,
        boundary_points=0,
        outside=0,
        part_pixels=None,
        poses=None,
        causes=(),
    )
    assert str(bare).split("\n") == [
        "bin in the image: 0 pixels, 0.0 % with depth, no depth",
        "boundary points: 0 in the bin, 0 edge points outside its box",
        "no likely cause of lost parts",
    ]


def test_the_facts_of_the_good_frame() -> None:
    boundary = extract_boundary(GOOD, scene.BIN)
    report = diagnose(GOOD, scene.BIN, scene.ELL, boundary)
    assert (report.boundary_points, report.outside, report.depth_share) == (len(boundary), boundary.outside, 1.0)
    assert 70_000 < report.pixels < 130_000  # 0.24 x 0.18 m at 0.6 m and 720 px are 62 000, turned by 0.3 rad
    assert report.median_depth == pytest.approx(0.6, abs=0.02)
    assert report.part_pixels == pytest.approx(720 * scene.ELL.d_max / 0.6, rel=0.03)
    assert report.poses is None


def test_a_cause_has_a_known_name_and_each_group_counts_once() -> None:
    with pytest.raises(ValueError, match=r"name must be one of depth_unit, depth_range, .*, got 'bad_luck'"):
        Cause(name="bad_luck", text="")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="each of the groups must count once, got PoseCounts"):
        PoseCounts(groups=3, found=1, by_score=1)


def test_each_cause_is_logged_once(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "_logged", set())
    with caplog.at_level(logging.WARNING, "perception"):
        log_causes(REPORT, without=("few_pixels", "underexposed"))
        with causes_unlogged():
            log_causes(REPORT)
        assert not caplog.records
        log_causes(REPORT)
        log_causes(REPORT)
    assert [(r.name, r.levelname, r.message) for r in caplog.records] == [
        ("perception.diagnosis.log", "WARNING", cause.text) for cause in CAUSES
    ]


def test_the_thickness_of_a_part_in_any_orientation() -> None:
    rng = np.random.default_rng(0)
    turned = make_transform(random_rotation(rng), rng.normal(size=3))
    box = trimesh.creation.box((0.06, 0.04, 0.002), turned)
    rod = trimesh.creation.cylinder(0.004, 0.05, transform=turned)
    assert part_thickness(PartModel.from_mesh("plate", box)) == pytest.approx(0.002, rel=1e-4)
    assert part_thickness(PartModel.from_mesh("rod", rod)) == pytest.approx(0.008, rel=0.02)
    assert part_thickness(scene.ELL) == pytest.approx(0.014)
