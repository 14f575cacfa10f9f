"""Height maps of known scenes, the clearance kernel against its naive twin, ranking beside walls and neighbours."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perception.geometry import make_transform, random_rotation, rotation_about, transform_points
from perception.part import PartModel
from policies.grasping.clearance import RankSettings, RankStats, clear_of_floor, clearances, rank_grasps
from policies.grasping.grasps import GraspSettings, sample_grasps
from policies.grasping.gripper import LEFT, PALM, RIGHT, gripper_model
from policies.grasping.heightmap import HeightMap
from policies.grasping.observed_scene import ObservedScene
from tests.policies.grasp_cell import WALL, box, candidate, in_bin, look, placed, workspace

TWIN = runpy.run_path(str(Path(__file__).parents[2] / "reference" / "clearance_twin.py"))["clearances"]
DOWN = np.diag([1.0, -1.0, -1.0])
BLOCK = (0.03, 0.05, 0.04)


@pytest.fixture(scope="module")
def gripper():
    return gripper_model()


@pytest.fixture(scope="module")
def part():
    return PartModel.from_mesh("block", box(BLOCK))


@pytest.fixture(scope="module")
def grasps(part, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BINPICK_CACHE", str(tmp_path_factory.mktemp("cache")))
        return sample_grasps(part, GraspSettings(samples=300, max_grasps=1000, max_checked=6000))


@pytest.fixture(scope="module")
def cell():
    return workspace(yaw=0.3)


def empty_map(cell, **frame_changes):
    return HeightMap.from_frame(replace(look(cell, []), **frame_changes), cell)


def ranked(cell, part, grasps, poses, gripper, *, others=(), settings=None):
    """Rank the part at its poses in the bin; ``others`` are seen but unknown."""
    frame = look(cell, [part.mesh.copy().apply_transform(T) for T in poses] + list(others))
    candidates = [candidate(cell, part.mesh, T) for T in poses]
    return rank_grasps(seen(frame, candidates, cell, grasps), grasps, gripper, settings)


def seen(frame, candidates, cell, grasps):
    return ObservedScene.from_frame(frame, candidates, cell, grasps.surface)


def test_a_step_is_where_it_stands(cell):
    scene = HeightMap.from_frame(look(cell, [box((0.06, 0.04, 0.03), placed(0.08, -0.05, 0.015))]), cell)
    at = lambda x, y: scene.highest_at(np.array([[x, y, 0.0]]))[0]  # noqa: E731
    assert at(0.08, -0.05) == pytest.approx(0.03, abs=1e-6)
    assert at(0.1085, -0.0315) == pytest.approx(0.03, abs=1e-6)
    assert at(0.047, -0.05) == pytest.approx(0, abs=1e-6)
    assert at(0.117, -0.05) == pytest.approx(0, abs=1e-6)  # behind the 4 mm that the box hides
    assert at(0.08, 0.05) == pytest.approx(0, abs=1e-6)  # fails if y flips
    assert at(0.185, 0) == pytest.approx(0.12)  # in the wall
    assert at(0.21, 0) == -WALL  # beyond it: the table
    assert scene.heights.shape == (200, 150)


def test_walls_are_known_without_being_seen(cell):
    scene = HeightMap.from_frame(look(cell, [], walls=False), cell)
    ring = np.ones(scene.heights.shape, dtype=bool)
    ring[scene.inner] = False
    assert np.all(scene.heights[ring] == 0.12)
    assert np.abs(scene.heights[scene.inner]).max() < 1e-6


def test_a_bin_that_is_no_multiple_of_the_cell_keeps_its_walls():
    cell = workspace(inner_size=(0.3013, 0.2007, 0.1))
    scene = HeightMap.from_frame(look(cell, []), cell)
    on_wall = np.array([[s * 0.15066, 0.0, 0.0] for s in (-1, 1)] + [[0.0, s * 0.10036, 0.0] for s in (-1, 1)])
    np.testing.assert_allclose(scene.highest_at(on_wall), 0.1)
    np.testing.assert_allclose(scene.highest_at(np.array([[0.149, 0.099, 0.0]])), 0, atol=1e-6)


def test_holes_are_as_high_as_their_surroundings_and_the_walls_do_not_leak(cell):
    block = box((0.04, 0.04, 0.05), placed(0, 0, 0.025))
    frame = look(cell, [block])
    depth = frame.depth.copy()
    depth[210:270, 270:294] = 0  # over the block's edge on the -x side and the floor beside it
    depth[:, 520:600] = np.nan  # up to the wall
    scene = HeightMap.from_frame(replace(frame, depth=depth), cell)
    assert np.all(np.isfinite(scene.heights))
    beside = np.array([[-0.0225, y, 0] for y in np.linspace(-0.015, 0.015, 9)])
    np.testing.assert_allclose(scene.highest_at(beside), 0.05, atol=1e-6)
    assert scene.heights[scene.inner][-5:].max() < 1e-6


def test_a_blind_frame_closes_the_bin(cell):
    scene = empty_map(cell, depth=np.zeros((480, 640), np.float32))
    assert np.all(scene.heights == 0.12)


@pytest.mark.slow
def test_the_target_is_taken_out_and_its_neighbours_stay(cell, part, grasps):
    poses = [placed(0, 0, 0.02), placed(0.031, 0.01, 0.02), placed(0.0, 0.0, 0.0601, yaw=1.2)]
    meshes = [part.mesh.copy().apply_transform(T) for T in poses]
    scene = HeightMap.from_frame(look(cell, meshes), cell)
    rasters = [scene.rasterise(grasps.surface, cell.T_world_bin @ T) for T in poses]
    at = lambda free, x, y: free.highest_at(np.array([[x, y, 0.0]]))[0]  # noqa: E731

    without_top = scene.without(rasters[2], np.maximum(rasters[0], rasters[1]))
    assert at(scene, 0, 0) == pytest.approx(0.08, abs=1e-3)
    assert at(without_top, 0, 0) == pytest.approx(0.04, abs=1e-3)  # the known part below it
    assert at(scene.without(rasters[2]), 0, 0) == pytest.approx(0, abs=1e-6)
    without_neighbour = scene.without(rasters[1], np.maximum(rasters[0], rasters[2]))
    assert at(without_neighbour, 0.04, 0.02) == pytest.approx(0, abs=1e-3)
    assert at(without_neighbour, 0, 0) == pytest.approx(0.08, abs=1e-3)
    left = without_neighbour.heights[scene.inner]
    assert left.min() >= 0


def test_a_hole_beside_the_target_does_not_keep_its_height(cell, part, grasps):
    frame = look(cell, [part.mesh.copy().apply_transform(placed(0, 0, 0.02))])
    depth = frame.depth.copy()
    depth[:, 290:302] = 0  # across the part's -x side and the floor
    scene = HeightMap.from_frame(replace(frame, depth=depth), cell)
    assert scene.highest_at(np.array([[-0.018, 0, 0]]))[0] > 0.03
    free = scene.without(scene.rasterise(grasps.surface, cell.T_world_bin @ placed(0, 0, 0.02)))
    assert np.abs(free.heights[scene.inner]).max() < 1e-3


def test_vertical_clearance_above_the_floor_by_hand(cell, gripper):
    width = 0.03
    T = cell.T_world_bin @ make_transform(DOWN, (0.02, 0.01, 0.012 + float(gripper.tip_z(width))))
    found = clearances(empty_map(cell), T[None], np.array([width]), gripper, retreats=())
    assert found[0, LEFT] == pytest.approx(0.012, abs=1e-4)
    assert found[0, RIGHT] == pytest.approx(0.012, abs=1e-4)
    assert found[0, PALM] == pytest.approx(0.012 + float(gripper.tip_z(width)) + 0.055, abs=2e-3)
    # Open, the tips stand higher; closing brings them down again.
    opening = np.array([0.08])
    open_only = clearances(empty_map(cell), T[None], opening, gripper, retreats=())
    lift = float(gripper.tip_z(width) - gripper.tip_z(0.08))
    assert open_only[0, LEFT] == pytest.approx(0.012 + lift, abs=1e-4)
    closing = clearances(empty_map(cell), T[None], opening, gripper, width=np.array([width]))
    assert closing[0, LEFT] == pytest.approx(0.012, abs=1e-4)


def test_one_finger_over_a_box_is_that_finger(cell, gripper):
    scene = HeightMap.from_frame(look(cell, [box((0.03, 0.03, 0.05), placed(0.1, -0.045, 0.025))]), cell)
    T = cell.T_world_bin @ make_transform(DOWN, (0.1, 0, 0.03 + float(gripper.tip_z(0.08))))
    found = clearances(scene, T[None], np.array([0.08]), gripper)
    # Pointing down with x kept, the tcp's +y is the bin's -y: the right finger stands over the box.
    assert found[0, RIGHT] == pytest.approx(-0.02, abs=1e-3)
    assert found[0, LEFT] == pytest.approx(0.03, abs=1e-3)


def test_kernel_equals_its_naive_twin(gripper):
    rng = np.random.default_rng(5)
    cell = workspace(yaw=0.7)
    frame = look(cell, [box((0.05, 0.05, 0.07), placed(0.03, 0.02, 0.035, 0.4))])
    scene = HeightMap.from_frame(frame, cell)
    low, high = (-0.3, -0.2, -0.1), (0.3, 0.2, 0.3)
    T = np.stack([make_transform(random_rotation(rng), rng.uniform(low, high)) for _ in range(6)])
    opening, width = rng.uniform(0.04, 0.09, 6), rng.uniform(-0.005, 0.04, 6)
    found = clearances(scene, cell.T_world_bin @ T, opening, gripper, width=width, retreats=(0.03,))
    moments = [[(o, 0), (o, 0.03), ((o + w) / 2, 0), (w, 0)] for o, w in zip(opening, width, strict=True)]
    map_of = scene.heights, scene.origin, scene.cell, scene.outside
    expected = TWIN(*map_of, T, moments, gripper.hull_points, gripper.labels)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_turning_the_whole_scene_changes_nothing(part, grasps, gripper):
    bodies = [box((0.03, 0.03, 0.05), placed(0.1, -0.045, 0.025))]
    bodies.append(box((0.1, 0.02, 0.02), placed(-0.05, 0.03, 0.01, 0.5)))
    T_bin_tcp = make_transform(DOWN @ rotation_about((1, 2, 3), 0.3), (0.0431, 0.0117, 0.0613))
    found = []
    for yaw in (0.0, np.pi / 2, 0.9):
        cell = workspace(yaw=yaw)
        scene = HeightMap.from_frame(look(cell, bodies), cell)
        found.append(clearances(scene, (cell.T_world_bin @ T_bin_tcp)[None], np.array([0.06]), gripper))
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)
    np.testing.assert_allclose(found[2], found[0], atol=1e-6)


def test_turning_the_contents_by_90_degrees_turns_the_map():
    cell = workspace(inner_size=(0.3, 0.3, 0.12))
    turn = make_transform(rotation_about((0, 0, 1), np.pi / 2))
    body = box((0.06, 0.03, 0.04), placed(0.051, 0.031, 0.02))
    before = HeightMap.from_frame(look(cell, [body]), cell).heights
    after = HeightMap.from_frame(look(cell, [body.copy().apply_transform(turn)]), cell).heights
    assert (np.abs(after - _turned(before)) > 1e-3).mean() < 0.01  # cells on the body's edges


def _turned(heights):
    """Return the map of the scene turned by +90 degrees about z: what was at (x, y) is at (-y, x)."""
    return heights.T[::-1]


def test_a_lone_part_is_ranked(cell, part, grasps, gripper):
    T_bin_part = placed(0.01, 0.02, 0.02, yaw=0.4)
    found, stats = ranked(cell, part, grasps, [T_bin_part], gripper)
    assert 3 <= len(found) <= 8
    assert [g.score for g in found] == sorted((g.score for g in found), reverse=True)
    best = found[0]
    assert min(abs(best.width - side) for side in BLOCK) < 1e-3
    assert best.features["covered"] == best.features["buried"] == 0
    assert best.T_world_grasp[2, 2] < -np.cos(np.radians(50))
    tip = best.T_world_tcp @ [0, 0, float(gripper.tip_z(best.width)), 1]
    np.testing.assert_allclose(tip, best.T_world_grasp[:, 3], atol=1e-9)
    assert stats.considered == len(grasps) == stats.tilted + stats.blocked + stats.clear
    assert (stats.parts, stats.parts_blocked) == (1, 0)
    for grasp in found:  # an independent look: no point of the gripper in the floor, a wall or the part
        for gap in (grasp.opening, grasp.width + 0.0015):
            points = transform_points(in_bin(cell, grasp.T_world_tcp), gripper.hull_points(gap))
            assert points[:, 2].min() > 0.001
            assert not part.mesh.copy().apply_transform(T_bin_part).contains(points).any()


def test_ranked_features_and_scores_stay_in_their_range(cell, part, grasps, gripper):
    poses = [placed(0, 0, 0.02), placed(0.1, 0.05, 0.02, 1.0), placed(0.05, -0.06, 0.015) @ make_transform(_side_up())]
    found, _ = ranked(cell, part, grasps, poses, gripper)
    assert {g.candidate for g in found} == {0, 1, 2}
    for grasp in found:
        assert all(0 <= value <= 1 for value in grasp.features.values())
        assert grasp.width < grasp.opening <= 0.084


def _side_up():
    return rotation_about((0, 1, 0), np.pi / 2)


def test_a_wall_beside_the_part_leaves_the_grasps_along_it(cell, part, grasps, gripper):
    beside_wall = placed(0.18 - 0.016, 0, 0.02)  # 1 mm from the wall at +x
    found, _ = ranked(cell, part, grasps, [beside_wall], gripper)
    assert found
    closing = np.abs(np.stack([in_bin(cell, g.T_world_grasp)[:3, 1] for g in found]))
    assert np.all(closing[:, 0] < 0.2)  # none reaches between part and wall
    free, _ = ranked(cell, part, grasps, [placed(0, 0, 0.02)], gripper)
    closing = np.abs(np.stack([in_bin(cell, g.T_world_grasp)[:3, 1] for g in free]))
    assert np.any(closing[:, 0] > 0.9)


@pytest.mark.parametrize("known", [True, False])
def test_a_touching_neighbour_blocks_its_side(cell, part, grasps, gripper, known):
    beside = placed(0.0301, 0, 0.02)
    neighbour = part.mesh.copy().apply_transform(beside)
    poses, others = ([placed(0, 0, 0.02), beside], []) if known else ([placed(0, 0, 0.02)], [neighbour])
    found, _ = ranked(cell, part, grasps, poses, gripper, others=others)
    mine = [g for g in found if g.candidate == 0]
    assert mine
    assert all(abs(in_bin(cell, g.T_world_grasp)[0, 1]) < 0.2 for g in mine)


def test_a_walled_in_part_has_no_clear_approach(cell, part, grasps, gripper):
    frame_of = [box((0.3, 0.06, 0.09), placed(0, s * 0.056, 0.045)) for s in (-1, 1)]
    frame_of += [box((0.1, 0.052, 0.09), placed(s * 0.066, 0, 0.045)) for s in (-1, 1)]
    found, stats = ranked(cell, part, grasps, [placed(0, 0, 0.02)], gripper, others=frame_of)
    assert found == []
    assert stats.clear == 0
    assert stats.parts_blocked == 1
    assert stats.blocked > 0


def test_a_narrow_gap_narrows_the_opening(cell, part, grasps, gripper):
    walls = [box((0.01, 0.2, 0.012), placed(s * (0.015 + 0.014 + 0.005), 0, 0.006)) for s in (-1, 1)]  # 14 mm a side

    def widest_low_opening(others):
        every = RankSettings(per_candidate=1000)
        found, _ = ranked(cell, part, grasps, [placed(0, 0, 0.02)], gripper, others=others, settings=every)
        poses = [in_bin(cell, g.T_world_grasp) for g in found]
        return max(g.opening for g, T in zip(found, poses, strict=True) if abs(T[0, 1]) > 0.99 and T[2, 3] < 0.0115)

    assert widest_low_opening([]) == pytest.approx(0.054, abs=1e-4)
    assert widest_low_opening(walls) == pytest.approx(0.040, abs=1e-4)  # 5 mm and 8 mm of pad on each side


def test_a_part_below_another_is_ranked_after_it(cell, part, grasps, gripper):
    poses = [placed(0, 0, 0.02), placed(0.02, 0.0, 0.0601)]  # the second leaves room beside it for the jaw
    found, _ = ranked(cell, part, grasps, poses, gripper)
    assert found[0].candidate == 1
    below = [g for g in found if g.candidate == 0]
    assert below
    assert all(g.features["covered"] == 0.5 and g.features["buried"] > 0.3 for g in below)
    assert max(g.score for g in below) < found[0].score - 0.2


def test_the_score_is_the_weighted_features_less_the_penalties(cell, part, grasps, gripper):
    poses = [placed(0, 0, 0.02), placed(0, 0.04, 0.0601)]  # the second lies over a fifth of the first
    found, _ = ranked(cell, part, grasps, poses, gripper)
    below = [g for g in found if g.candidate == 0]
    assert below
    weights = {
        "quality": 0.30,
        "vertical": 0.10,
        "score": 0.10,
        "visible": 0.10,
        "height": 0.25,
        "wall": 0.05,
        "clearance": 0.05,
        "opening": 0.05,
        "covered": -0.30,
        "buried": -0.20,
    }
    for grasp in found:
        assert grasp.features.keys() == weights.keys()
        assert grasp.score == pytest.approx(sum(weights[name] * value for name, value in grasp.features.items()))
    assert all(g.features["covered"] == 0.5 and g.features["buried"] > 0.1 for g in below)


def test_grasps_of_one_part_differ(cell, part, grasps, gripper):
    found, _ = ranked(cell, part, grasps, [placed(0, 0, 0.02)], gripper)
    for i, a in enumerate(found):
        for b in found[:i]:
            apart = np.linalg.norm(a.T_world_grasp[:3, 3] - b.T_world_grasp[:3, 3]) >= 0.010
            turned = a.T_world_grasp[:3, 2] @ b.T_world_grasp[:3, 2] <= np.cos(np.radians(20))
            twisted = abs(a.T_world_grasp[:3, 1] @ b.T_world_grasp[:3, 1]) <= np.cos(np.radians(20))
            assert apart or turned or twisted


def test_no_candidate_no_grasp(cell, grasps, gripper):
    assert rank_grasps(seen(look(cell, []), [], cell, grasps), grasps, gripper) == ([], RankStats())


def test_an_estimate_outside_of_the_bin_or_an_empty_set_gives_nothing(cell, part, grasps, gripper):
    astray = candidate(cell, part.mesh, placed(0.1, 0.05, -0.5))
    found, stats = rank_grasps(seen(look(cell, []), [astray], cell, grasps), grasps, gripper)
    assert found == []
    assert stats.parts_blocked == 1
    nothing = grasps.take(np.arange(0))
    lying = candidate(cell, part.mesh, placed(0, 0, 0.02))
    found, stats = rank_grasps(seen(look(cell, []), [lying], cell, grasps), nothing, gripper)
    assert found == []
    assert stats.considered == 0


def test_a_strict_tilt_rejects_more(cell, part, grasps, gripper):
    poses = [placed(0, 0, 0.02)]
    _, wide = ranked(cell, part, grasps, poses, gripper)
    strict, narrow = ranked(cell, part, grasps, poses, gripper, settings=RankSettings(max_tilt=0.1))
    assert narrow.tilted > wide.tilted
    assert all(g.T_world_grasp[2, 2] < -np.cos(0.1) + 1e-9 for g in strict)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"max_tilt": 2.0}, "max_tilt must be in"),
        ({"margin": 0.0}, "margin must be positive, got 0.0"),
        ({"per_candidate": 0}, "per_candidate must be positive"),
    ],
)
def test_settings_reject_nonsense(wrong, text):
    with pytest.raises(ValueError, match=text):
        RankSettings(**wrong)


def test_wrong_shapes_and_cells_are_named(cell, gripper):
    scene = empty_map(cell)
    with pytest.raises(ValueError, match=r"T_world_tcp must be \(N, 4, 4\)"):
        clearances(scene, np.eye(4), np.ones(1), gripper)
    with pytest.raises(ValueError, match=r"opening must be \(2,\)"):
        clearances(scene, np.stack([np.eye(4)] * 2), np.ones(1), gripper)
    with pytest.raises(ValueError, match=r"width must be \(1,\)"):
        clearances(scene, np.eye(4)[None], np.ones(1), gripper, width=np.ones(2))
    with pytest.raises(ValueError, match="target must be"):
        scene.without(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="others must be"):
        scene.without(scene.measured, np.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"points_a must be \(N, 3\)"):
        scene.rasterise(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="cell and wall must be positive"):
        HeightMap.from_frame(look(cell, [], width=16, height=12), cell, cell=0.0)


def test_default_weights_add_up_to_one():
    settings = RankSettings()
    assert sum(getattr(settings, name) for name in vars(settings) if name.startswith("weight_")) == pytest.approx(1)


def test_a_lone_block_is_picked_off_the_floor_across_its_upright_sides(part, grasps, gripper):
    T = make_transform(translation=(0.0, 0.0, BLOCK[2] / 2))
    clear = clear_of_floor(T, grasps, gripper)
    assert 0 < clear.sum() < len(grasps)
    kept = grasps.take(np.flatnonzero(clear))
    assert np.abs(kept.T_part_grasp[:, 2, 1]).max() < np.sin(np.radians(5))  # no finger under the block
    assert (-kept.T_part_grasp[:, 2, 2]).min() >= np.cos(RankSettings().max_tilt)
    room = clearances(HeightMap.plane(), T @ gripper.tcp_from_grasp(kept.T_part_grasp, kept.width), kept.width, gripper)
    assert room.min() > 0
    sunk = make_transform(translation=(0.0, 0.0, BLOCK[2] / 2 - 0.08))
    assert not clear_of_floor(sunk, grasps, gripper).any()
