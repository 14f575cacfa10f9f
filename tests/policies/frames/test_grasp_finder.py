"""Grasps on parts found in a frame, whatever its world is, and which of them a robot reaches."""

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from perception.frame import Workspace
from perception.geometry import Floats, invert_transform, make_transform, rotation_about
from perception.part import PartModel
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.verification.verification import Verdict
from policies.frames import FrameGrasp, GraspFinder, Reach, grasp_finder
from policies.frames import reach as reach_module
from policies.frames.grasp_finder import PER_PART
from policies.grasping import GraspSet, GraspSettings, sample_grasps
from tests.perception.block_scene import BIN, ELL, POSES, photographed

FRAME = photographed(*POSES)


def few_grasps(part: PartModel, *, jaw: float | None = None) -> GraspSet:
    """Return the grasps that a coarse sampling finds, in a second instead of many."""
    return sample_grasps(part, GraspSettings(samples=60, turns=8, max_grasps=300, max_checked=1500), jaw=jaw)


def found_poses() -> list[PoseEstimate]:
    scores = {"score": 0.9, "surface_score": 0.9, "visible_fraction": 0.8, "margin": 5.0, "score_drop": 5.0}
    verdict = cast(Verdict, None)  # no grasp depends on it
    return [
        PoseEstimate(T_cam_part=T, instance_idx=k, verdict=verdict, size=200, **scores) for k, T in enumerate(POSES)
    ]


def in_bin(base: tuple[float, float, float], turn: float = 0.0) -> Floats:
    """Return the pose of a robot's base that stands at a place in the bin's frame."""
    return BIN.T_world_bin @ make_transform(rotation_about((0, 0, 1), turn), base)


@pytest.fixture(scope="module", autouse=True)
def _grasps_are_few() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grasp_finder, "sample_grasps", few_grasps)
        yield


@pytest.fixture(scope="module")
def finder(_grasps_are_few: None) -> GraspFinder:
    return GraspFinder(ELL)


@pytest.fixture(scope="module")
def grasps(finder: GraspFinder) -> list[FrameGrasp]:
    return finder.find(FRAME, BIN, found_poses())


def test_grasps_come_from_above_and_hold_the_part(grasps: list[FrameGrasp]) -> None:
    assert {each.grasp.candidate for each in grasps} <= {0, 1}
    assert 1 <= len(grasps) <= 2 * PER_PART
    scores = [each.grasp.score for each in grasps]
    assert scores == sorted(scores, reverse=True)
    for each in grasps:
        assert each.reachable is None
        T_part_grasp = invert_transform(POSES[each.grasp.candidate]) @ each.grasp.T_world_grasp
        assert np.linalg.norm(T_part_grasp[:3, 3] - ELL.centre) < ELL.d_max
        assert each.grasp.T_world_grasp[2, 2] > np.cos(np.radians(50))  # the camera looks along z
        assert each.grasp.width < each.grasp.opening


def test_grasps_do_not_depend_on_the_world(finder: GraspFinder, grasps: list[FrameGrasp]) -> None:
    T = make_transform(rotation_about((0.2, 0.5, -0.3), 1.0), (0.3, -0.2, 1.0))
    moved = finder.find(
        replace(FRAME, T_world_cam=T),
        Workspace(T_world_bin=T @ BIN.T_world_bin, inner_size=BIN.inner_size),
        found_poses(),
    )
    assert len(moved) == len(grasps)
    for a, b in zip(grasps, moved, strict=True):
        np.testing.assert_allclose(b.grasp.T_world_grasp, T @ a.grasp.T_world_grasp, atol=1e-9)
        np.testing.assert_allclose(b.grasp.T_world_tcp, T @ a.grasp.T_world_tcp, atol=1e-9)


def test_a_wall_of_measurements_beside_a_part_blocks_its_grasps(finder: GraspFinder) -> None:
    high = replace(FRAME, depth=np.where(FRAME.grey == 60, FRAME.depth - 0.06, FRAME.depth))  # the floor, raised
    assert finder.find(high, BIN, found_poses()) == []


@pytest.mark.slow
def test_the_robot_reaches_what_is_near_its_base(finder: GraspFinder) -> None:
    for base, expected in (((-0.5, 0.0, 0.1), True), ((-3.0, 0.0, 0.1), False)):
        near = GraspFinder(ELL, reach=Reach(in_bin(base), BIN))
        found = near.find(FRAME, BIN, found_poses())
        assert len(found) > 0
        assert all(each.reachable is expected for each in found)


def shifted(T: Floats) -> Workspace:
    """Return the bin, moved by a transform in its own frame."""
    return Workspace(T_world_bin=BIN.T_world_bin @ T, inner_size=BIN.inner_size)


def test_reach_is_judged_over_the_bin_that_was_measured() -> None:
    higher = shifted(make_transform(translation=(0.0, 0.0, 0.09)))  # whose floor is above the parts
    reach = Reach(in_bin((-0.5, 0.0, 0.1)), higher)
    found = GraspFinder(ELL, reach=reach).find(FRAME, BIN, found_poses())
    assert not any(reach.reaches(each.grasp.T_world_tcp, each.grasp.opening) for each in found)
    assert len(found) > 0
    assert all(each.reachable for each in found)


def test_reach_over_the_same_bin_is_not_compiled_again() -> None:
    reach = Reach(in_bin((-0.5, 0.0, 0.1)), BIN, jaw=0.06)
    assert reach.at(shifted(make_transform(translation=(5e-5, 0.0, 0.0)))) is reach
    turned = reach.at(shifted(make_transform(rotation_about((0, 0, 1), 0.01))))
    assert turned is not reach
    np.testing.assert_array_equal(turned.T_world_base, reach.T_world_base)
    larger = Workspace(T_world_bin=BIN.T_world_bin, inner_size=BIN.inner_size + 0.01)
    assert reach.at(larger).workspace is larger


def test_reach_over_another_bin_is_that_made_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    reach = Reach(in_bin((-0.5, 0.0, 0.1)), BIN, jaw=0.06)
    T = make_transform(rotation_about((0, 0, 1), 0.3), (0.02, -0.01, 0.004))
    other = Workspace(T_world_bin=BIN.T_world_bin @ T, inner_size=BIN.inner_size + np.array([0.02, -0.01, 0.03]))
    made = Reach(reach.T_world_base, other, 0.06)
    monkeypatch.setattr(reach_module, "PlanningScene", None)  # nothing is compiled as a whole
    moved = reach.at(other)
    rng = np.random.default_rng(0)
    for _ in range(6):
        grasp = make_transform(np.diag([1.0, -1.0, -1.0]), rng.uniform((-0.1, -0.07, 0.0), (0.1, 0.07, 0.15)))
        T_world_tcp = other.T_world_bin @ grasp @ make_transform(rotation_about((0, 0, 1), rng.uniform(0, 3)))
        assert moved.reaches(T_world_tcp, 0.05) == made.reaches(T_world_tcp, 0.05)


def test_reach_is_unknown_over_a_bin_that_is_measured_tilted(caplog: pytest.LogCaptureFixture) -> None:
    tilted = shifted(make_transform(rotation_about((1, 0, 0), np.radians(5))))
    base = tilted.T_world_bin @ make_transform(translation=(-0.5, 0.0, 0.1))
    found = GraspFinder(ELL, reach=Reach(base, tilted)).find(FRAME, BIN, found_poses())
    assert len(found) > 0
    assert {each.reachable for each in found} == {None}
    assert "reach is not known over the bin as it was measured: the z axes of the robot's base and of" in caplog.text


def test_the_reach_is_that_of_the_cell_wherever_its_world_is() -> None:
    grasp = make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.15))  # in the bin's frame, pointing down
    bases = [in_bin((-0.5, 0.0, 0.13), turn=turn) for turn in (0.0, 1.0)]
    assert [Reach(base, BIN).reaches(BIN.T_world_bin @ grasp, 0.05) for base in bases] == [True, True]
    low = make_transform(translation=(0.0, 0.0, -0.2)) @ grasp  # below the bin's floor
    assert not Reach(bases[0], BIN).reaches(BIN.T_world_bin @ low, 0.05)


def test_a_base_of_another_world_is_refused() -> None:
    with pytest.raises(ValueError, match=r"must agree to 3 degrees, got 180\.0: check --robot-base"):
        Reach(np.eye(4), BIN)
    with pytest.raises(ValueError, match="floor must be lower than the robot's base, got one that is 50 mm"):
        Reach(in_bin((-0.5, 0.0, -0.05)), BIN)


def test_a_box_without_a_bin_may_be_too_large(finder: GraspFinder) -> None:
    wide = Workspace(T_world_bin=BIN.T_world_bin, inner_size=np.array([2.5, 1.0, 0.2]))
    with pytest.raises(ValueError, match=r"grasps need a bin of at most 2 m, got 2\.50 m: state the bin"):
        finder.find(FRAME, wide, found_poses())


def test_a_part_without_grasps_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    none = few_grasps(ELL).take(np.zeros(0, np.int64))
    monkeypatch.setattr(grasp_finder, "sample_grasps", lambda *_, **__: none)
    with pytest.raises(ValueError, match=r"the jaw .* finds no grasp on"):
        GraspFinder(ELL, jaw=0.022)
