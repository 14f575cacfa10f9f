"""Nothing is compiled or loaded while the first frame is timed."""

import logging
import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from binpick_env.config import CellConfig
from binpick_env.observation import pixel_perceiver
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.pixel_perceiver import gt_masks_perceiver
from binpick_env.observation.warm_up import warm_up_capture
from binpick_env.parts import load_part
from perception.diagnosis import diagnose, log_causes
from perception.diagnosis import log as diagnosis_log
from perception.geometry import make_transform, rotation_about, transform_points
from perception.part import PartModel
from tests.binpick_env.observed_cell import cell

WORKSPACE = CellConfig().bin.workspace()

# In a process of its own: in this one, other tests have called the kernels.
FIRST_FRAME = """
import sys
from numba.core.dispatcher import Dispatcher
from binpick_env.config import CameraConfig
from binpick_env.env import BinPickEnv

def versions():
    modules = [(name, module) for name, module in sys.modules.items() if name.startswith(("perception", "binpick_env"))]
    found = {f"{name}.{key}": value for name, module in modules for key, value in vars(module).items()}
    return {name: len(value.signatures) for name, value in found.items() if isinstance(value, Dispatcher)}

def late_kernels(perception):
    env = BinPickEnv("tee", 3, perception=perception, threads=1, camera=CameraConfig(width=640, height=480))
    before = versions()
    env.reset(seed=31)
    after = versions()
    late = {name for name, count in after.items() if count != before.get(name)}
    print("torch" in sys.modules, len(env.candidates), sum(after.values()), *sorted(late))

late_kernels("gt_masks")
late_kernels("oracle")
late_kernels("learned")
"""


@pytest.mark.slow
def test_no_kernel_is_compiled_in_the_first_frame_and_torch_is_loaded_for_a_network_only() -> None:
    run = subprocess.run(
        [sys.executable, "-c", FIRST_FRAME], env=os.environ, capture_output=True, text=True, check=True
    )
    for line, torch in zip(run.stdout.splitlines(), (False, False, True), strict=True):
        loaded, candidates, compiled, *late = line.split()
        assert loaded == str(torch)
        assert int(candidates) == 3
        assert int(compiled) > 20
        assert late == []


def test_two_parts_lie_on_the_floor_in_the_middle_of_the_bin() -> None:
    part = load_part("tee").model
    view = warm_up_capture(part, WORKSPACE)
    ids, depth = view.capture.instance_ids, view.capture.depth_true
    assert set(np.unique(ids)) == {-1, 0, 1}
    assert np.all(view.visible_fractions > 0.5)
    for n, T_world_part in enumerate(view.T_world_parts):
        assert np.allclose(T_world_part[:3, :3].T @ T_world_part[:3, :3], np.eye(3))
        points_bin = WORKSPACE.to_bin(transform_points(T_world_part, np.asarray(part.mesh.vertices)))
        assert points_bin[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        assert np.all(np.abs(points_bin[:, :2]) < WORKSPACE.inner_size[:2] / 2)
        assert 0.9 - depth[ids == n].min() == pytest.approx(points_bin[:, 2].max(), abs=0.003)  # as the camera sees it
    assert depth[ids == -1].max() == pytest.approx(0.9, abs=1e-6)  # the floor


def test_the_warm_up_takes_any_part_in_any_bin() -> None:
    large = PartModel.from_mesh("beam", trimesh.creation.box((0.5, 0.02, 0.02)))
    turned = make_transform(rotation_about((0, 0, 1), 0.4), (0.3, 0.2, 0.1))
    view = warm_up_capture(large, type(WORKSPACE)(T_world_bin=turned, inner_size=np.array([0.2, 0.1, 0.05])))
    assert set(np.unique(view.capture.instance_ids)) == {-1, 0, 1}
    np.testing.assert_array_equal(warm_up_capture(large, view.workspace).capture.frame.depth, view.capture.frame.depth)


def test_a_small_part_is_as_long_in_the_warm_up_as_one_of_60_mm() -> None:
    """Segmentation refuses parts that are too short in the image, which a small part is in a small image."""
    cubes = [PartModel.from_mesh("cube", trimesh.creation.box((side,) * 3)) for side in (0.01, 0.035)]
    views = [warm_up_capture(cube, WORKSPACE) for cube in cubes]
    widths = [np.ptp(np.flatnonzero((view.capture.instance_ids == 0).any(axis=0))) for view in views]
    assert widths[0] == pytest.approx(widths[1], rel=0.1)


def test_the_warm_up_of_a_small_part_warns_of_nothing_and_uses_no_warning_up(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its camera magnifies, so that it sees neither the whole bin nor most of its own image of it."""
    monkeypatch.setattr(diagnosis_log, "_logged", set())
    monkeypatch.setattr(pixel_perceiver, "_warmed_up", set())
    ball = PartModel.from_mesh("ball", trimesh.creation.icosphere(subdivisions=2, radius=0.02))
    gt_masks_perceiver(ball, WORKSPACE, threads=1)
    assert pixel_perceiver._warmed_up == {"gt_masks"}
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert diagnosis_log._logged == set()
    report = diagnose(warm_up_capture(ball, WORKSPACE).capture.frame, WORKSPACE, ball)
    log_causes(report)  # a user's frame like it is still warned of
    assert "of the bin's image lies within the frame" in caplog.text


@pytest.mark.slow
def test_only_the_first_perceiver_of_each_mode_warms_up(monkeypatch: pytest.MonkeyPatch) -> None:
    captures: list[LabelledCapture] = []

    def perceive(
        _: object, labelled: LabelledCapture, __: np.random.Generator, *, likely: bool = False
    ) -> ObservedCandidates:
        captures.append(labelled)
        return ObservedCandidates(candidates=[])

    monkeypatch.setattr(pixel_perceiver, "_warmed_up", set())
    monkeypatch.setattr(pixel_perceiver.PixelPerceiver, "perceive", perceive)
    for perception, count in (("gt_masks", 1), ("gt_masks", 1), ("learned", 2), ("gt_masks", 2)):
        cell("bracket", perception=perception)
        assert len(captures) == count
