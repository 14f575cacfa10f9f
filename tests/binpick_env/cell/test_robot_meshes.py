"""The robot's visible meshes are coarse copies, in place, and change nothing of the physics."""

import mujoco
import numpy as np
import pytest
from scipy.spatial import cKDTree

from binpick_env.cell import robot, robot_meshes
from binpick_env.cell.robot import robot_spec
from binpick_env.cell.robot_meshes import CUBE, coarsened
from binpick_env.config import RobotConfig

FAR = np.sqrt(3.0) * CUBE  # largest distance of two points in a cube [m]


@pytest.fixture(scope="module")
def original() -> mujoco.MjModel:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robot, "use_coarse_meshes", lambda _: None)
        return robot_spec(RobotConfig()).compile()


@pytest.fixture(scope="module")
def coarse() -> mujoco.MjModel:
    return robot_spec(RobotConfig()).compile()


def shown(model: mujoco.MjModel) -> list[int]:
    """Return the mesh geoms that nothing collides with."""
    is_mesh = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    return [int(geom) for geom in np.flatnonzero(is_mesh & (model.geom_contype == 0))]


def world_points(model: mujoco.MjModel, geom: int) -> np.ndarray:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mesh = model.geom_dataid[geom]
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    return vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]


@pytest.mark.slow
def test_every_shown_mesh_lies_where_it_lay(original: mujoco.MjModel, coarse: mujoco.MjModel) -> None:
    assert shown(coarse) == shown(original)
    for geom in shown(original):
        fine, few = world_points(original, geom), world_points(coarse, geom)
        assert cKDTree(fine).query(few)[0].max() < FAR
        assert cKDTree(few).query(fine)[0].max() < 2 * FAR  # a cube whose faces all collapsed has no vertex left


def test_cells_hold_far_fewer_faces(original: mujoco.MjModel, coarse: mujoco.MjModel) -> None:
    def faces(model: mujoco.MjModel) -> int:
        return int(model.mesh_facenum[np.unique(model.geom_dataid[shown(model)])].sum())

    assert faces(coarse) < 0.5 * faces(original)
    assert {coarse.mesh(k).name for k in range(coarse.nmesh)} >= {"upperarm_3/coarse", "gripper/base"}


@pytest.mark.parametrize(
    "name",
    ["body_mass", "body_inertia", "body_ipos", "body_iquat", "body_invweight0", "dof_M0", "geom_contype", "geom_matid"],
)
def test_the_physics_stays_the_same_bit_by_bit(name: str, original: mujoco.MjModel, coarse: mujoco.MjModel) -> None:
    np.testing.assert_array_equal(getattr(coarse, name), getattr(original, name))


def test_colliding_shapes_stay(original: mujoco.MjModel, coarse: mujoco.MjModel) -> None:
    for geom in np.flatnonzero(original.geom_contype):
        np.testing.assert_array_equal(coarse.geom_size[geom], original.geom_size[geom])
        np.testing.assert_array_equal(coarse.geom_pos[geom], original.geom_pos[geom])
        if original.geom_dataid[geom] >= 0:
            np.testing.assert_array_equal(world_points(coarse, geom), world_points(original, geom))


def test_vertices_in_a_cube_become_their_mean() -> None:
    near = 0.25 * CUBE
    vertices = np.array([[0, 0, 0], [near, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + 0.1 * near
    faces = np.array([[0, 2, 3], [1, 2, 3], [0, 1, 4], [0, 3, 4]], np.int32)
    few = coarsened(vertices, faces)
    assert few.faces.tolist() == [[0, 3, 2], [0, 2, 1]]  # one of the two that coincide, and not the one that collapsed
    assert few.vertices[0] == pytest.approx(vertices[:2].mean(axis=0))
    assert len(few.vertices) == 4


def test_small_meshes_have_smaller_cubes() -> None:
    rng = np.random.default_rng(0)
    vertices = rng.uniform(0, 0.02, (4000, 3))
    few = coarsened(vertices, np.arange(3999, dtype=np.int32).reshape(-1, 3))
    assert cKDTree(few.vertices).query(vertices[:3999])[0].max() < np.sqrt(3) * robot_meshes.FRACTION * 0.02
