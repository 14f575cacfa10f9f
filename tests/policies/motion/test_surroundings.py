"""Another bin around the same robot: what was compiled once is moved, and equals what is compiled as a whole."""

import mujoco
import numpy as np
import pytest

from binpick_env.config import BinConfig, CellConfig, RobotConfig, TrayConfig
from policies.motion import PlanningScene
from policies.motion.surroundings import with_surroundings

ELSEWHERE = CellConfig(
    robot=RobotConfig(pedestal_height=0.21),
    bin=BinConfig(inner_size=(0.2, 0.43, 0.07), wall=0.02, position=(0.52, 0.11), yaw=0.4),
    tray=TrayConfig(position=(0.0, 2.0)),
)
# What follows from masses, for dynamics, and a light's place about the centre of mass.
DYNAMICS = {
    *("actuator_acc0", "body_invweight0", "body_subtreemass", "dof_M0", "dof_invweight0", "light_poscom0"),
}


@pytest.fixture(scope="module")
def scene() -> PlanningScene:
    return PlanningScene(CellConfig(bin=BinConfig(wall=0.02)))


def arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    named = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value for name, value in named.items() if isinstance(value, np.ndarray) and name not in DYNAMICS}


def test_a_moved_scene_is_the_one_compiled_as_a_whole(scene: PlanningScene) -> None:
    moved, made = scene.around(ELSEWHERE), PlanningScene(ELSEWHERE)
    for one, other in ((moved.model, made.model), (moved.arm_model, made.arm_model)):
        there = arrays(other)
        assert {"geom_pos", "geom_size", "body_pos", "bvh_aabb", "bvh_nodeid"} <= set(there)
        for name, value in arrays(one).items():
            np.testing.assert_array_equal(value, there[name], err_msg=name)
    points = np.random.default_rng(0).uniform((0, -0.5, 0), (1, 0.5, 0.4), (200, 3))
    np.testing.assert_array_equal(moved.static_height(points), made.static_height(points))
    assert (moved.rim, moved.max_opening) == (made.rim, made.max_opening)
    for q in np.random.default_rng(1).uniform(-2, 2, (40, 6)):
        assert moved.contacts(q, clearance=0.02) == made.contacts(q, clearance=0.02)
        np.testing.assert_array_equal(moved.tcp_poses(q[None]), made.tcp_poses(q[None]))


def test_the_scene_that_was_moved_stays_where_it_was(scene: PlanningScene) -> None:
    before = {name: value.copy() for name, value in arrays(scene.model).items()}
    config = scene.config
    scene.around(ELSEWHERE)
    assert scene.config is config
    for name, value in arrays(scene.model).items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)


def test_another_robot_or_another_kind_of_bin_is_refused(scene: PlanningScene) -> None:
    with pytest.raises(ValueError, match=r"the robot must be the scene's .* but for its pedestal, got "):
        scene.around(CellConfig(robot=RobotConfig(jaw=0.05)))
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="wall", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 1])
    with pytest.raises(ValueError, match="the body 'world' must have the same geoms in both models, got"):
        with_surroundings(scene.model, spec.compile(), 0.1)
