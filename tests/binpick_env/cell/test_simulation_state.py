"""The parts' states, with MuJoCo itself as the oracle, and a state that diverged."""

import mujoco
import numpy as np
import pytest

from binpick_env.cell.robot import ARM_JOINTS, HOME, TCP_SITE
from binpick_env.cell.simulation import Simulation
from perception.geometry import make_transform, matrix_from_quat, random_rotation
from tests.binpick_env.small_cell import centred, grip, small_simulation, wait

# --- parts


def test_parked_parts_hang_where_they_are(simulation: Simulation) -> None:
    before = simulation.part_poses()
    wait(simulation, 1.0)
    np.testing.assert_array_equal(simulation.part_poses(), before)
    assert simulation.asleep().all()
    assert not simulation.in_play.any()
    assert before[:, 2, 3].max() < -3.0


@pytest.mark.parametrize("substeps", range(16))
def test_a_part_that_is_placed_while_it_falls_asleep_falls(simulation: Simulation, substeps: int) -> None:
    """After 9 substeps a parked part is awake but about to sleep, and MuJoCo let it do so in mid-air."""
    simulation.reset()
    simulation.advance(substeps * simulation.model.opt.timestep)
    simulation.place(1, centred(simulation, (0.5, 0.0, 0.5)))
    simulation.advance(0.1)
    assert not simulation.asleep()[1]
    assert simulation.part_centres()[1, 2] == pytest.approx(0.5 - 9.81 * 0.1**2 / 2, abs=0.002)


def test_a_placed_part_falls_freely(simulation: Simulation) -> None:
    pose = centred(simulation, (0.5, 0.0, 0.8), angle=0.4)
    simulation.place(1, pose)
    np.testing.assert_allclose(simulation.part_poses()[1], pose, atol=1e-12)
    np.testing.assert_array_equal(simulation.in_play, [False, True, False])
    wait(simulation, 0.2)
    fallen = 0.8 - simulation.part_centres()[1, 2]
    assert fallen == pytest.approx(0.5 * 9.81 * 0.2**2, rel=0.02)
    assert simulation.part_speeds()[1] == pytest.approx(9.81 * 0.2, rel=0.02)


def test_a_part_is_parked_and_placed_again(simulation: Simulation) -> None:
    simulation.place(0, centred(simulation, (0.5, 0.0, 0.8)))
    wait(simulation, 0.2)
    simulation.park(0)
    assert not simulation.in_play[0]
    assert simulation.part_speeds()[0] == 0.0
    wait(simulation, 1.0)
    assert simulation.part_centres()[0, 2] < -3.9
    assert simulation.asleep()[0]
    simulation.place(0, centred(simulation, (0.5, 0.0, 0.8)))
    wait(simulation, 0.2)
    assert simulation.part_speeds()[0] > 1.0


def test_a_rims_speed_counts(simulation: Simulation) -> None:
    simulation.place(0, centred(simulation, (0.5, 0.0, 0.8)))
    simulation.data.qvel[simulation.model.joint("part_0").dofadr[0] + 5] = 10.0
    assert simulation.part_speeds()[0] == pytest.approx(10.0 * simulation.part.model.d_max / 2)


def test_reset_forgets_everything(simulation: Simulation) -> None:
    grip(simulation, 0)
    wait(simulation, 0.5, HOME + 0.3, 1.0)
    simulation.reset()
    assert simulation.time == 0.0
    np.testing.assert_array_equal(simulation.joint_positions, HOME)
    np.testing.assert_array_equal(simulation.target, HOME)
    assert (simulation.gripper_target, simulation.gripper_position) == (0.0, 0.0)
    assert not simulation.in_play.any()
    first = [simulation.joint_positions for _ in range(5) if simulation.step(HOME - 0.2, 0.5) is None]
    fresh = small_simulation()
    again = [fresh.joint_positions for _ in range(5) if fresh.step(HOME - 0.2, 0.5) is None]
    np.testing.assert_array_equal(first, again)


# --- MuJoCo as the oracle


def test_poses_are_mujocos(simulation: Simulation) -> None:
    rng = np.random.default_rng(1)
    for i in range(3):
        simulation.place(i, make_transform(random_rotation(rng), (0.5, 0.15 * i - 0.15, 0.4)))
    simulation.step(HOME - 0.1, 0.6)
    mujoco.mj_forward(simulation.model, simulation.data)
    for i, pose in enumerate(simulation.part_poses()):
        body = simulation.data.body(f"part_{i}")
        np.testing.assert_allclose(pose[:3, 3], body.xpos, atol=1e-12)
        np.testing.assert_allclose(pose[:3, :3], matrix_from_quat(body.xquat), atol=1e-12)
        np.testing.assert_allclose(simulation.part_centres()[i], body.xipos, atol=1e-12)
    site = simulation.data.site(TCP_SITE)
    np.testing.assert_array_equal(simulation.T_world_tcp[:3, :3], site.xmat.reshape(3, 3))
    np.testing.assert_array_equal(simulation.T_world_tcp[:3, 3], site.xpos)
    for k, name in enumerate(ARM_JOINTS):
        assert simulation.joint_positions[k] == simulation.data.joint(name).qpos[0]
        assert simulation.joint_velocities[k] == simulation.data.joint(name).qvel[0]


def test_speeds_are_mujocos(simulation: Simulation) -> None:
    simulation.place(0, make_transform(random_rotation(np.random.default_rng(2)), (0.5, 0.0, 0.6)))
    simulation.data.qvel[simulation.model.joint("part_0").dofadr[0] + np.arange(3, 6)] = (3.0, -2.0, 1.0)
    wait(simulation, 0.1)
    mujoco.mj_forward(simulation.model, simulation.data)
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(
        simulation.model, simulation.data, mujoco.mjtObj.mjOBJ_XBODY, simulation.model.body("part_0").id, velocity, 0
    )
    assert simulation.part_speeds()[0] == pytest.approx(
        np.linalg.norm(velocity[3:]) + np.linalg.norm(velocity[:3]) * simulation.part.model.d_max / 2
    )


# --- faults


@pytest.mark.slow
@pytest.mark.parametrize("where", ["qpos", "qvel", "xfrc_applied"])
def test_a_diverged_state_is_an_error(simulation: Simulation, where: str) -> None:
    """MuJoCo used to put the state back to its own start, silently."""
    getattr(simulation.data, where)[-1] = np.nan
    with pytest.raises(FloatingPointError, match=r"the physics diverged at t = 0\.\d{3} s \(NaN in the state\)"):
        wait(simulation, 0.2)
    simulation.reset()
    wait(simulation, 0.2)
    assert np.isfinite(simulation.data.qpos).all()
