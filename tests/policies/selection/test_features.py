"""Features of a grasp by hand: a block on the floor of a bin, one beside it, and nothing else."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from binpick_env.candidates import PoseCandidate
from perception.geometry import Floats, make_transform, rotation_about
from policies.grasping.clearance import RankSettings
from policies.grasping.failed_grasps import FailedGrasps
from policies.grasping.grasps import flip
from policies.grasping.gripper import LEFT, PALM, RIGHT, gripper_model
from policies.grasping.observed_scene import ObservedScene
from policies.grasping.outcomes import GraspCandidate
from policies.selection.features import FEATURES, HIGH, LOW, RANKED, GraspScene, column, feature_rows
from tests.policies.grasp_cell import WALL, box, candidate, look, placed, workspace

BIN = workspace(yaw=0.7)  # 0.36 x 0.26 x 0.12 m
BLOCK = box((0.02, 0.04, 0.03))
SURFACE = np.asarray(BLOCK.sample(4000, seed=0))
ON_FLOOR = placed(0, 0, 0.015)
# Approach straight down, closing along the bin's x, from above the block's middle.
DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
SHARES = dict(zip(RANKED, np.linspace(0.05, 0.95, len(RANKED)).tolist(), strict=True))


def seen(*T_bin_parts: Floats, **changes: Any) -> list[PoseCandidate]:
    return [candidate(BIN, BLOCK, T, **changes) for T in T_bin_parts]


def scene(candidates: list[PoseCandidate], *unknown: Any) -> GraspScene:
    blocks = [BLOCK.copy().apply_transform(np.linalg.inv(BIN.T_world_bin) @ c.T_world_part) for c in candidates]
    return GraspScene(
        seen=ObservedScene.from_frame(look(BIN, [*blocks, *unknown]), candidates, BIN, SURFACE, wall=WALL),
        d_max=0.05,
        gripper=gripper_model(),
        rank=RankSettings(),
        failed=FailedGrasps(radius=0.02),
    )


def grasp(x: float = 0.0, y: float = 0.0, tip: float = 0.012, *, R: Floats = DOWN, **facts: Any) -> GraspCandidate:
    T_world_grasp = BIN.T_world_bin @ make_transform(R, (x, y, tip))
    width = facts.pop("width", 0.02)
    T_world_tcp = gripper_model().tcp_from_grasp(T_world_grasp[None], np.array([width]))[0]
    usual = {"opening": 0.04, "candidate": 0, "score": 0.4, "features": SHARES}
    return GraspCandidate(T_world_grasp=T_world_grasp, T_world_tcp=T_world_tcp, width=width, **{**usual, **facts})


def row(where: GraspScene, one: GraspCandidate, dexterity: float = 0.15) -> dict[str, float]:
    rows = feature_rows(where, [one], np.array([dexterity]))
    assert rows.shape == (1, len(FEATURES))
    assert rows.dtype == np.float32
    return dict(zip(FEATURES, rows[0].tolist(), strict=True))


@pytest.fixture(scope="module")
def alone() -> GraspScene:
    return scene(seen(ON_FLOOR))


# --- one by one ------------------------------------------------------------------------------------------------------


def test_a_place_is_in_shares_of_the_bin(alone: GraspScene) -> None:
    found = row(alone, grasp(0.09, -0.0325, 0.06))
    assert [found[axis] for axis in "xyz"] == pytest.approx([0.5, -0.25, 0.25], abs=1e-6)


def test_the_hand_is_turned_as_in_the_bin(alone: GraspScene) -> None:
    found = row(alone, grasp())
    assert [found[f"approach_{axis}"] for axis in "xyz"] == pytest.approx([0, 0, -1], abs=1e-6)
    assert [found[f"closing_{axis}"] for axis in "xyz"] == pytest.approx([1, 0, 0], abs=1e-6)
    leaning = row(alone, grasp(R=rotation_about((0, 0, 1), 0.3) @ rotation_about((1, 0, 0), 0.4) @ DOWN))
    tilt = np.array([0.0, np.sin(0.4), -np.cos(0.4)])
    expected = rotation_about((0, 0, 1), 0.3) @ tilt
    assert [leaning[f"approach_{axis}"] for axis in "xyz"] == pytest.approx(expected.tolist(), abs=1e-6)
    closing = [np.cos(0.3), np.sin(0.3), 0.0]
    assert [leaning[f"closing_{axis}"] for axis in "xyz"] == pytest.approx(closing, abs=1e-6)


def test_the_rankings_features_are_passed_on(alone: GraspScene) -> None:
    found = row(alone, grasp())
    assert {name: found[name] for name in RANKED} == pytest.approx(SHARES)
    assert found["rank"] == pytest.approx(0.4)
    assert row(alone, grasp(score=-0.3))["rank"] == pytest.approx(-0.3)


def test_the_jaw_is_in_shares_of_its_stroke(alone: GraspScene) -> None:
    found, stroke = row(alone, grasp()), gripper_model().stroke
    assert found["width"] == pytest.approx(0.02 / stroke)
    assert found["gap"] == pytest.approx(0.04 / stroke)


def test_the_part_is_described() -> None:
    found = row(scene(seen(ON_FLOOR, fill=0.7)), grasp(0.003, 0.004, 0.015))
    assert found["top"] == pytest.approx(0.03 / 0.24)
    assert found["fill"] == pytest.approx(0.7)
    assert found["offset"] == pytest.approx(0.005 / 0.025, abs=1e-6)


def test_dexterity_is_the_arms(alone: GraspScene) -> None:
    assert row(alone, grasp(), dexterity=0.15)["dexterity"] == pytest.approx(0.5)


def test_parts_seen_are_counted() -> None:
    both = scene(seen(ON_FLOOR, placed(0.1, 0, 0.015)))
    assert row(both, grasp())["seen"] == pytest.approx(2 / 32)


def test_a_part_is_suspect_once_an_attempt_on_it_failed() -> None:
    both = scene(seen(ON_FLOOR, placed(0.1, 0, 0.015)))
    both.failed.add(both.seen.candidates[1].centre_world, np.eye(4))
    assert [row(both, grasp(candidate=k))["suspect"] for k in (0, 1)] == [0.0, 1.0]


def test_each_finger_has_its_own_clearance() -> None:
    """The tips are 12 mm above the floor; a slab 6 mm high lies where one finger comes down, not where it ends."""
    for side, name in ((1, "clearance_front"), (-1, "clearance_back")):
        slab = box((0.04, 0.08, 0.006), placed(side * 0.04, 0, 0.003))
        found = row(scene(seen(ON_FLOOR), slab), grasp())
        other = {"clearance_front": "clearance_back", "clearance_back": "clearance_front"}[name]
        higher = float(gripper_model().tip_z(0.02) - gripper_model().tip_z(0.03))  # half way of closing
        assert found[name] == pytest.approx((0.006 + higher - 0.001) / 0.02, abs=0.02)
        assert found[other] == pytest.approx((0.012 - 0.001) / 0.02, abs=0.02)
        assert found["clearance_palm"] == 1.0


def test_the_part_itself_is_not_in_the_way_but_its_neighbour_is() -> None:
    beside = placed(0.033, 0, 0.015)  # under the open finger, 30 mm high
    both = scene(seen(ON_FLOOR, beside))
    assert row(both, grasp())["clearance_front"] == 0.0
    assert row(both, grasp())["clearance_back"] == pytest.approx(0.55, abs=0.02)
    assert row(both, grasp(0.033, candidate=1))["clearance_back"] == 0.0
    assert row(scene(seen(ON_FLOOR)), grasp())["clearance_front"] == pytest.approx(0.55, abs=0.02)


def test_a_wall_takes_the_palms_clearance() -> None:
    deep = scene(seen(placed(0.16, 0, 0.015)))
    assert row(deep, grasp(0.16))["clearance_front"] == 0.0  # the finger would be in the wall
    leaning = rotation_about((0, 1, 0), 0.6) @ DOWN
    assert row(deep, grasp(0.16, R=leaning))["clearance_palm"] < 1.0


# --- properties ------------------------------------------------------------------------------------------------------


@given(yaw=st.floats(0, 6.3), tilt=st.floats(0, 0.8))
@settings(max_examples=25, deadline=None)
def test_the_jaw_turned_by_half_is_the_same_row(yaw: float, tilt: float) -> None:
    """The gripper is turned as well, since its points are not sampled alike on both sides."""
    where = scene_with_a_slab()
    one = grasp(R=rotation_about((0, 0, 1), yaw) @ rotation_about((0, 1, 0), tilt) @ DOWN)
    facts = {name: getattr(one, name) for name in ("width", "opening", "candidate", "score", "features")}
    T_world_grasp, T_world_tcp = flip(one.T_world_grasp), flip(one.T_world_tcp)
    turned = GraspCandidate(T_world_grasp=T_world_grasp, T_world_tcp=T_world_tcp, **facts)
    gripper = where.gripper
    labels = np.where(gripper.labels == PALM, PALM, LEFT + RIGHT - gripper.labels)
    points = np.ascontiguousarray(gripper.points * (-1.0, -1.0, 1.0))
    there = replace(where, gripper=replace(gripper, points=points, labels=labels))
    assert row(there, turned) == pytest.approx(row(where, one), abs=1e-6)


_cached: list[GraspScene] = []


def scene_with_a_slab() -> GraspScene:
    if not _cached:
        _cached.append(scene(seen(ON_FLOOR), box((0.04, 0.08, 0.006), placed(0.04, 0, 0.003))))
    return _cached[0]


@given(
    place=st.tuples(*[st.floats(-3, 3)] * 3),
    score=st.floats(-5, 5),
    dexterity=st.floats(0, 50),
    width=st.floats(0.001, 0.5),
)
@settings(max_examples=40, deadline=None)
def test_features_are_finite_and_in_range(
    place: tuple[float, float, float], score: float, dexterity: float, width: float
) -> None:
    where = scene_with_a_slab()
    wild = grasp(*place, score=score, width=width, opening=2 * width, features=dict.fromkeys(RANKED, score))
    values = np.array(list(row(where, wild, dexterity).values()), dtype=np.float32)
    assert np.all(np.isfinite(values))
    assert np.all(values >= LOW)
    assert np.all(values <= HIGH)


def test_rows_do_not_depend_on_each_other() -> None:
    both = scene(seen(ON_FLOOR, placed(0.1, 0, 0.015)))
    grasps = [grasp(), grasp(0.1, candidate=1), grasp(0.0, 0.01)]
    dexterity = np.array([0.1, 0.2, 0.3])
    rows = feature_rows(both, grasps, dexterity)
    np.testing.assert_array_equal(feature_rows(both, grasps[::-1], dexterity[::-1]), rows[::-1])
    np.testing.assert_array_equal(feature_rows(both, grasps[1:2], dexterity[1:2]), rows[1:2])


def test_no_grasps_are_no_rows(alone: GraspScene) -> None:
    assert feature_rows(alone, [], np.zeros(0)).shape == (0, len(FEATURES))


def test_an_empty_row_is_in_range() -> None:
    assert np.all((LOW <= 0) & (HIGH >= 0) & (LOW < HIGH))


def test_each_grasp_needs_its_dexterity(alone: GraspScene) -> None:
    with pytest.raises(ValueError, match=r"dexterity must be \(1,\), got \(2,\)"):
        feature_rows(alone, [grasp()], np.zeros(2))


def test_columns_have_names() -> None:
    assert column("x") == 0
    assert column("rank") == len(FEATURES) - 1 == 30
    with pytest.raises(ValueError, match=r"there is no feature 'weight'; there are x, y, z, .*rank"):
        column("weight")
