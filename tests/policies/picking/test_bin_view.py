"""Arm and load before the bin are known before a frame is taken, and so is their way out of sight."""

from collections.abc import Iterator

import numpy as np
import pytest

from binpick_env.camera.sensor import SensorModel
from binpick_env.env import BinPickEnv
from perception.geometry import Floats
from policies.grasping.heightmap import HeightMap
from policies.picking.bin_view import BinView
from policies.picking.load_image import image_of
from policies.picking.scripted import ScriptedPicker
from tests.policies.hand_cell import SMALL_IMAGE, HandCell

pytestmark = pytest.mark.slow
EVERY = 4  # number of control steps between two looks


@pytest.fixture(scope="module")
def carried() -> Iterator[tuple[BinPickEnv, list[tuple[bool, bool, bool]]]]:
    """Yield a cell, and for moments of an attempt: in sight of the camera, of one with a projector, and in an image."""
    env = BinPickEnv("tee", num_parts=(1, 2), perception="oracle", threads=1, camera=SMALL_IMAGE, sensor="none")
    cell = HandCell(env, ScriptedPicker(env))
    cell.lay(cell.flat(0.05))
    camera, moments, steps = BinView(env), [], [0]
    env.sensor = SensorModel(baseline=0.15)
    projector = BinView(env)
    env.sensor = "none"
    real = env.simulation.step

    def step(joint_targets: Floats, gripper: float) -> None:
        real(joint_targets, gripper)
        steps[0] += 1
        if steps[0] % EVERY == 0:
            moments.append((not camera.clear(), not projector.clear(), shown(env)))

    env.simulation.step = step  # type: ignore[method-assign]
    cell.picker.pick()
    yield env, moments
    del env.simulation.step


def shown(env: BinPickEnv) -> bool:
    """Return whether an image without noise shows anything far above the rim."""
    heights = HeightMap.from_frame(image_of(env, np.random.default_rng(0)), env.workspace)
    return bool((heights.measured > heights.rim + 0.06).any())


def test_whatever_an_image_shows_before_the_bin_is_known(
    carried: tuple[BinPickEnv, list[tuple[bool, bool, bool]]],
) -> None:
    _, moments = carried
    assert sum(image for _, _, image in moments) > 5
    assert [known for known, _, image in moments if image and not known] == []
    # It is not only said to be in sight: of the moments without it in the image most are known to be free.
    assert np.mean([not known for known, _, image in moments if not image]) > 0.5


def test_the_projector_needs_more_room_than_the_camera(
    carried: tuple[BinPickEnv, list[tuple[bool, bool, bool]]],
) -> None:
    _, moments = carried
    assert all(projector for camera, projector, _ in moments if camera)
    assert sum(projector for _, projector, _ in moments) > sum(camera for camera, _, _ in moments)


def test_at_home_nothing_is_in_the_way(carried: tuple[BinPickEnv, list[tuple[bool, bool, bool]]]) -> None:
    env, moments = carried
    assert moments[-1] == (False, False, False)
    env.reset(seed=0)
    assert BinView(env).clear()
