"""The unit of a bin's size, told by what is measured in the bin."""

from dataclasses import replace

import numpy as np
import pytest

from perception.diagnosis import diagnose
from perception.diagnosis.samples import DepthSamples
from perception.diagnosis.setup import Setup
from perception.diagnosis.size_unit import size_unit_cause
from perception.frame import Frame, Workspace
from perception.geometry import camera_matrix, make_transform
from tests.perception.diagnosis import bin_scene as scene

GOOD = scene.good()[0]


@pytest.mark.parametrize(
    ("unit", "scale"), [("millimetres", 0.001), ("centimetres", 0.01), ("inches", 0.0254), ("centimetres", None)]
)
def test_the_unit_of_a_size_is_that_by_which_the_measurements_fill_the_bin(unit: str, scale: float | None) -> None:
    """In a smaller unit the box lies within the bin, and is full, too; without measurements it is the plausible one."""
    size = scene.BIN.inner_size / (scale or 0.01) * (1.2 if unit == "inches" else 1.0)
    depth = GOOD.depth if scale else np.where(np.arange(480) < 10, GOOD.depth, np.float32(0))
    given = replace(Setup.of(GOOD, scene.BIN), inner_size=size)
    found = size_unit_cause(DepthSamples.of(replace(GOOD, depth=depth)), given)
    assert found is not None
    assert f"it seems to be in {unit};" in found[0].text


def box_of_parts(inner_size: np.ndarray, pile: float) -> tuple[DepthSamples, Setup]:
    """Return what a camera 0.9 m above a table sees of a bin on it that is evenly filled, and the true setup."""
    K = camera_matrix(400.0, 640, 480)
    above = make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.9))
    setup = Setup(K=K, T_world_cam=above, T_world_bin=np.eye(4), inner_size=inner_size)
    depth = np.full((480, 640), 0.9)
    v, u = np.indices(depth.shape)
    for size, height in ((inner_size[:2] + 0.02, inner_size[2]), (inner_size[:2], pile)):
        away = (0.9 - height) / 400.0
        inside = (np.abs(u - K[0, 2]) * away <= size[0] / 2) & (np.abs(v - K[1, 2]) * away <= size[1] / 2)
        depth[inside] = 0.9 - height
    frame = Frame(depth=depth.astype(np.float32), K=K, T_world_cam=above)
    return DepthSamples.of(frame), setup


@pytest.mark.parametrize(("unit", "scale"), [("centimetres", 0.01), ("inches", 0.0254)])
def test_the_largest_box_whose_height_is_reached_tells_the_unit(unit: str, scale: float) -> None:
    """A box in inches holds a bin in cm and some of the table, and one in cm lies in the pile of a bin in inches."""
    for size in (np.array([0.26, 0.2, 0.08]), np.array([0.3, 0.26, 0.1])):
        samples, setup = box_of_parts(size * (0.5 if unit == "centimetres" else 1.0), 0.03)
        found = size_unit_cause(samples, replace(setup, inner_size=setup.inner_size / scale))
        assert found is not None
        assert f"it seems to be in {unit};" in found[0].text


def test_a_bin_as_large_as_a_room_is_believed() -> None:
    lower = scene.BIN.T_world_bin @ make_transform(translation=(0.0, 0.0, -scene.TABLE))
    large = Workspace(T_world_bin=lower, inner_size=np.array([3.1, 2.0, 0.8]))
    assert diagnose(GOOD, large, scene.ELL).causes == ()
