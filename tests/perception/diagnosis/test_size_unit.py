"""The unit of a bin's size, told by what is measured in the bin."""

from dataclasses import replace

import numpy as np
import pytest

from perception.diagnosis import diagnose
from perception.diagnosis.samples import DepthSamples
from perception.diagnosis.setup import Setup
from perception.diagnosis.size_unit import size_unit_cause
from perception.frame import Workspace
from perception.geometry import make_transform
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


def test_a_bin_as_large_as_a_room_is_believed() -> None:
    lower = scene.BIN.T_world_bin @ make_transform(translation=(0.0, 0.0, -scene.TABLE))
    large = Workspace(T_world_bin=lower, inner_size=np.array([3.1, 2.0, 0.8]))
    assert diagnose(GOOD, large, scene.ELL).causes == ()
