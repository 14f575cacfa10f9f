"""What is gone from the bin beside a picked part, on images made by hand."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from binpick_env.camera.depth_camera import default_pose
from binpick_env.config import CameraConfig, SensorPreset
from perception.frame import Frame, Workspace
from perception.geometry import camera_matrix, make_transform
from perception.part import PartModel
from policies.grasping.heightmap import HeightMap
from policies.grasping.observed_scene import ObservedScene
from policies.picking.load_image import bin_changed, gone_beside, image_of, mean_silhouette, shows_motion
from tests.binpick_env.small_cell import small_env

WORKSPACE = Workspace(T_world_bin=make_transform(translation=(0.5, 0.1, 0.02)), inner_size=np.array([0.3, 0.2, 0.1]))
WALL, DISTANCE, SIZE = 0.02, 0.9, (320, 240)
PART = PartModel.from_mesh("plate", trimesh.creation.box((0.06, 0.04, 0.01)))
SURFACE = np.asarray(trimesh.sample.sample_surface(PART.mesh, 20000, seed=0)[0])
Box = tuple[float, float, float]  # middle of a plate in the bin, x and y, and height of its upper side [m]
TARGET, NEIGHBOUR = (-0.08, 0.0, 0.01), (0.05, 0.03, 0.02)


def frame_of(boxes: Sequence[Box], noise: float = 0.0) -> Frame:
    """Return the image of plates that lie in the bin along its axes."""
    K = camera_matrix(600.0, *SIZE)
    depth = np.full(SIZE[::-1], DISTANCE)
    u, v = np.arange(SIZE[0])[None], np.arange(SIZE[1])[:, None]
    for x, y, top in boxes:
        z = DISTANCE - top
        inside = np.abs((u - K[0, 2]) * z / K[0, 0] - x) <= 0.03
        depth[inside & (np.abs(-(v - K[1, 2]) * z / K[1, 1] - y) <= 0.02)] = z
    depth += noise * np.random.default_rng(0).normal(size=depth.shape)
    return Frame(depth=depth.astype(np.float32), K=K, T_world_cam=default_pose(WORKSPACE, DISTANCE))


def gone(
    before: Sequence[Box], after: Sequence[Box], noise: float = 0.0, image: Frame | None = None, shift: float = 0.0
) -> float | None:
    """Return the area that is gone beside the part at ``TARGET``, whose estimate is off by ``shift`` along x [m^2]."""
    frame = frame_of(before)
    heights = HeightMap.from_frame(frame, WORKSPACE, wall=WALL)
    scene = ObservedScene(frame=frame, candidates=(), workspace=WORKSPACE, heights=heights, parts=())
    T_world_part = WORKSPACE.T_world_bin @ make_transform(translation=(TARGET[0] + shift, TARGET[1], TARGET[2] - 0.005))
    return gone_beside(scene, frame_of(after, noise) if image is None else image, SURFACE, T_world_part, WALL)


def test_nothing_is_gone_beside_a_part_that_came_alone() -> None:
    assert gone([TARGET, NEIGHBOUR], [NEIGHBOUR]) == 0.0
    assert abs(gone([TARGET, NEIGHBOUR], [NEIGHBOUR], noise=0.0005)) < 1e-4


def test_a_pose_that_is_off_by_some_millimetres_leaves_nothing_beside_it() -> None:
    assert gone([TARGET, NEIGHBOUR], [NEIGHBOUR], shift=0.007) == 0.0
    assert gone([TARGET, NEIGHBOUR], [NEIGHBOUR], shift=0.02) > 2e-4


@pytest.mark.parametrize("neighbour", [NEIGHBOUR, (-0.02, 0.0, 0.01), (0.1, -0.07, 0.06)])
def test_a_neighbour_that_came_along_leaves_its_area(neighbour: Box) -> None:
    area = gone([TARGET, neighbour], [])
    assert area == pytest.approx(0.06 * 0.04, rel=0.15)
    assert area / mean_silhouette(PART) > 0.5


def test_the_sum_is_zero_for_a_neighbour_that_only_moved() -> None:
    assert gone([TARGET, NEIGHBOUR], [(0.0, -0.05, 0.02)]) == pytest.approx(0.0, abs=2e-4)


def test_what_lay_on_the_part_and_came_along_leaves_its_area() -> None:
    """Three quarters of it lie on the part, within the outline, and a quarter beside it."""
    on_top = (TARGET[0] + 0.015, 0.0, 0.02)
    assert gone([TARGET, on_top], []) > 0.6 * 0.06 * 0.04
    assert gone([TARGET, on_top], [on_top]) == 0.0


def test_the_sum_is_zero_for_a_neighbour_that_slid_to_where_the_part_was() -> None:
    assert gone([TARGET, NEIGHBOUR], [TARGET]) == pytest.approx(0.0, abs=2e-4)
    assert gone([TARGET], [TARGET]) < -0.9 * 0.06 * 0.04


@pytest.mark.parametrize(("above_rim", "hidden"), [(0.05, False), (0.07, True)])
def test_an_image_that_the_arm_hides_tells_nothing(above_rim: float, hidden: bool) -> None:
    arm = (0.0, 0.0, float(WORKSPACE.inner_size[2]) + above_rim)
    assert (gone([TARGET, NEIGHBOUR], [arm]) is None) is hidden


def test_what_lay_under_the_part_does_not_show() -> None:
    assert gone([TARGET], [(*TARGET[:2], 0.0)]) == 0.0


def test_an_image_that_reports_another_pose_is_of_the_same_camera() -> None:
    """The pose that is reported may be corrected by the bin anew in each frame."""
    after = frame_of([NEIGHBOUR])
    moved = replace(after, T_world_cam=make_transform(translation=(0.01, 0.0, 0.01)) @ after.T_world_cam)
    assert gone([TARGET, NEIGHBOUR], [], image=moved) == 0.0


def test_the_silhouette_of_a_box_is_a_quarter_of_its_surface() -> None:
    assert mean_silhouette(PART) == pytest.approx((0.06 * 0.04 + 0.06 * 0.01 + 0.04 * 0.01) / 2)


def test_an_image_of_another_camera_is_refused() -> None:
    after = frame_of([NEIGHBOUR])
    small = Frame(depth=after.depth[:-2], K=after.K, T_world_cam=after.T_world_cam)
    text = r"the image must be by the camera of the scene's frame, got images of \(238, 320\) and \(240, 320\)"
    with pytest.raises(ValueError, match=text):
        gone([TARGET, NEIGHBOUR], [], image=small)


def test_an_image_shows_the_bin_now_and_leaves_the_frame() -> None:
    env = small_env()
    env.reset(seed=0)
    frame, candidates, number = env.frame, env.candidates, env.frame_id
    rng, state = np.random.default_rng(1), env.np_random.bit_generator.state
    same = image_of(env, rng)
    np.testing.assert_array_equal(same.T_world_cam, frame.T_world_cam)
    assert np.median(np.abs(same.depth - frame.depth)[frame.depth > 0]) < 0.001
    for part in np.flatnonzero(env.simulation.in_play):
        env.simulation.park(int(part))
    empty = image_of(env, rng)
    floor = np.median(empty.depth[empty.depth > 0])
    lower = (empty.depth - same.depth > 0.005) & (same.depth > 0)
    assert lower.sum() > 500
    assert np.median(empty.depth[lower]) == pytest.approx(floor, abs=0.003)
    assert (env.frame, env.candidates, env.frame_id) == (frame, candidates, number)
    assert env.np_random.bit_generator.state == state


@pytest.mark.parametrize(("height", "changed"), [(0.03, False), (0.4, True)])
def test_a_frame_in_which_the_arm_hides_the_bin_is_outdated(height: float, changed: bool) -> None:
    """What is far above the bin can only be the arm."""
    env = small_env()
    env.reset(seed=0)
    env.simulation.place(0, env.workspace.T_world_bin @ make_transform(translation=(0.0, 0.0, height)))
    env.look()
    assert bin_changed(env, image_of(env, np.random.default_rng(0)), 0.002) is changed


@pytest.mark.parametrize("sensor", ["good", "harsh", "stereo", "tof"])
@pytest.mark.parametrize(("moved", "changed"), [(0.0, False), (0.02, True)])
def test_a_frame_is_outdated_where_a_part_has_moved(sensor: SensorPreset, moved: float, changed: bool) -> None:
    env = small_env(sensor=sensor, camera=CameraConfig(width=640, height=480))
    env.reset(seed=0)
    pose = env.simulation.part_poses()[0]
    pose[:3, 3] += (0.0, moved, 0.0)
    env.simulation.move(0, pose)
    assert bin_changed(env, image_of(env, np.random.default_rng(0)), 0.002) is changed


@pytest.mark.parametrize(
    ("sides", "shown"),
    [
        ((0.06, 0.04, 0.005), True),
        ((0.06, 0.04, 0.0025), False),  # its place looks the same without it
        ((0.025, 0.018, 0.012), True),
        ((0.02, 0.014, 0.009), False),
    ],
)
def test_thin_and_tiny_parts_move_unseen(sides: tuple[float, float, float], shown: bool) -> None:
    assert shows_motion(PartModel.from_mesh("box", trimesh.creation.box(sides))) is shown
