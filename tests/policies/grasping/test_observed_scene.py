"""What is left of a scene without each of its parts, and that a frame is laid out once."""

import numpy as np
import pytest
import trimesh

from perception.geometry import Floats
from policies.grasping.clearance import RankSettings
from policies.grasping.heightmap import HeightMap
from policies.grasping.observed_scene import ObservedScene
from policies.picking.scripted import ScriptedPicker
from policies.picking.settings import PickerSettings
from tests.last_frame import change_frame
from tests.policies.grasp_cell import WALL, box, candidate, look, placed, workspace
from tests.policies.hand_cell import HandCell, hand_cell

BIN = workspace(yaw=0.7)
BLOCK = box((0.03, 0.05, 0.04))
SURFACE = np.asarray(BLOCK.sample(8000, seed=0))


def lay_out(*T_bin_parts: Floats, unknown: tuple[trimesh.Trimesh, ...] = ()) -> ObservedScene:
    frame = look(BIN, [*(BLOCK.copy().apply_transform(T) for T in T_bin_parts), *unknown])
    return ObservedScene.from_frame(frame, [candidate(BIN, BLOCK, T) for T in T_bin_parts], BIN, SURFACE, wall=WALL)


def test_each_part_is_taken_out_of_the_map_and_the_others_stay() -> None:
    scene = lay_out(placed(0, 0, 0.02), placed(0.02, 0.01, 0.06), placed(-0.1, 0.05, 0.02, 0.5))
    heights = HeightMap.from_frame(scene.frame, BIN, wall=WALL)
    np.testing.assert_array_equal(scene.heights.heights, heights.heights)
    rasters = [heights.rasterise(SURFACE, c.T_world_part) for c in scene.candidates]
    for row, part in enumerate(scene.parts):
        others = np.max([raster for k, raster in enumerate(rasters) if k != row], axis=0)
        np.testing.assert_array_equal(part.surroundings.heights, heights.without(rasters[row], others).heights)


def test_a_lone_part_leaves_the_floor() -> None:
    (part,) = lay_out(placed(0, 0, 0.02)).parts
    middle = BIN.T_world_bin[:3, 3][None]
    assert part.surroundings.highest_at(BIN.to_bin(middle))[0] == pytest.approx(0.0, abs=1e-6)
    assert (part.covering, part.buried) == (0, 0.0)


def test_who_lies_above_is_counted_and_what_is_measured_above_too() -> None:
    low, high = lay_out(placed(0, 0, 0.02), placed(0.015, 0, 0.06)).parts
    assert (low.covering, high.covering) == (1, 0)
    assert low.buried == pytest.approx(0.5, abs=0.1)
    assert high.buried == 0.0
    (hidden,) = lay_out(placed(0, 0, 0.02), unknown=(box((0.1, 0.1, 0.02), placed(0, 0, 0.06)),)).parts
    assert (hidden.covering, hidden.buried) == (0, 1.0)


def test_a_part_beside_the_map_is_buried_and_an_empty_scene_has_no_parts() -> None:
    frame = look(BIN, [])
    astray = candidate(BIN, BLOCK, placed(0.6, 0.4, 0.02))
    (part,) = ObservedScene.from_frame(frame, [astray], BIN, SURFACE, wall=WALL).parts
    assert (part.covering, part.buried) == (0, 1.0)
    assert ObservedScene.from_frame(frame, [], BIN, SURFACE, wall=WALL).parts == ()


def test_cell_and_wall_arrive() -> None:
    scene = ObservedScene.from_frame(look(BIN, []), [], BIN, SURFACE, cell=0.004, wall=0.03)
    assert (scene.heights.cell, scene.heights.outside) == (0.004, -0.03)


@pytest.fixture(scope="module")
def tees() -> HandCell:
    return hand_cell("tee")


def test_a_picker_lays_a_frame_out_once(tees: HandCell, monkeypatch: pytest.MonkeyPatch) -> None:
    env, picker = tees.env, tees.picker
    tees.lay(tees.flat())
    made: list[ObservedScene] = []
    from_frame = ObservedScene.from_frame

    def counted(*args: object, **options: object) -> ObservedScene:
        made.append(from_frame(*args, **options))  # type: ignore[arg-type]
        return made[-1]

    monkeypatch.setattr(ObservedScene, "from_frame", counted)
    grasps = picker.grasps()
    picker.plan(grasps[0])
    assert picker.observed_scene() is picker.observed_scene() is made[0]
    assert (made[0].frame, made[0].candidates) == (env.frame, env.candidates)
    assert len(made) == 1
    env.look()
    assert picker.observed_scene() is made[1]
    change_frame(env, candidates=[])
    assert picker.observed_scene().parts == ()
    assert len(made) == 3


def test_the_settings_of_the_ranking_arrive_in_the_map(tees: HandCell) -> None:
    coarse = ScriptedPicker(tees.env, PickerSettings(rank=RankSettings(cell=0.004)))
    tees.lay(tees.flat())
    assert coarse.observed_scene().heights.cell == 0.004
    assert coarse.observed_scene().heights.outside == -tees.env.config.bin.wall
