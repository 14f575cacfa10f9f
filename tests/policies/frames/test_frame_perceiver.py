"""Frames whose bin stands anywhere: the box that is searched without any, and what is said of another one."""

from dataclasses import replace

import numpy as np
import pytest

from perception.boundary import extract_boundary, organised_points
from perception.diagnosis import log
from perception.frame import Frame
from perception.geometry import Floats, make_transform, random_rotation, transform_points
from policies.frames import BinSettings, FramePerceiver, workspace_of_depth
from tests.perception.block_scene import BIN, POSES, KnowingPredictor, photographed
from tests.perception.diagnosis import bin_scene
from tests.perception.pose.estimator_scene import quick_estimator

FRAME = photographed(*POSES)


def measured_world(frame: Frame) -> Floats:
    v, u = np.nonzero(frame.valid)
    return transform_points(frame.T_world_cam, organised_points(frame, np.column_stack([u, v])))


@pytest.mark.parametrize("seed", range(3))
def test_the_box_holds_all_that_is_measured_from_any_camera(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frame = replace(FRAME, T_world_cam=make_transform(random_rotation(rng), rng.normal(size=3)))
    box = workspace_of_depth(frame)
    assert box.contains(measured_world(frame), margin=0.005).all()
    assert not workspace_of_depth(FRAME).contains(measured_world(frame)).all()


def test_the_box_ends_just_behind_the_farthest_measurement_and_opens_towards_the_camera() -> None:
    box = workspace_of_depth(FRAME)
    far, near = FRAME.depth.max(), FRAME.depth[FRAME.valid].min()
    assert box.T_world_bin[2, 3] == pytest.approx(far + 0.006)
    assert box.T_world_bin[:3, 2].tolist() == pytest.approx([0, 0, -1])
    assert box.inner_size[2] == pytest.approx(far - near + 0.012)


def test_no_boundary_point_of_the_parts_is_lost() -> None:
    known = {tuple(pixel) for pixel in extract_boundary(FRAME, BIN).pixels.tolist()}
    found = {tuple(pixel) for pixel in extract_boundary(FRAME, workspace_of_depth(FRAME)).pixels.tolist()}
    assert len(known) > 500
    assert len(known - found) <= 0.01 * len(known)


def test_a_frame_without_depth_has_a_box_too() -> None:
    dark = replace(FRAME, depth=np.zeros_like(FRAME.depth))
    assert np.all(workspace_of_depth(dark).inner_size > 0)


def test_a_depth_in_millimetres_is_refused() -> None:
    with pytest.raises(ValueError, match=r"depths must be at most 20 m, got 56\d.* m: set --depth-scale"):
        workspace_of_depth(replace(FRAME, depth=1000 * FRAME.depth))


def searching(inner_size: Floats) -> FramePerceiver:
    """Return a perceiver that looks for a bin, without the weights of a network."""
    perceiver = FramePerceiver.__new__(FramePerceiver)
    perceiver.part, perceiver.workspace = bin_scene.ELL, None
    perceiver.predictor, perceiver.estimator = KnowingPredictor(bin_scene.true_groups), quick_estimator(bin_scene.ELL)
    perceiver.bin = BinSettings(find=True, inner_size=inner_size)
    return perceiver


def test_a_principal_point_with_swapped_coordinates_is_named_where_no_bins_place_is_known(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(log, "_logged", set())
    good = bin_scene.good()[0]
    K = good.K.copy()
    K[:2, 2] = K[1::-1, 2]
    for frame, said in ((good, []), (replace(good, K=K), ["camera_matrix"])):
        seen = searching(bin_scene.BIN.inner_size).perceive(frame)
        assert seen.report is not None
        assert len(seen.poses) == 4
        assert [cause.name for cause in seen.report.causes] == said
    assert "cx and cy of K seem to be swapped" in caplog.text


def test_a_bin_of_another_size_is_logged(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "_logged", set())
    seen = searching(bin_scene.BIN.inner_size - np.array([0.008, 0.008, 0.0])).perceive(bin_scene.good()[0])
    assert seen.report is not None
    (cause,) = (cause for cause in seen.report.causes if cause.name == "bin_size")
    assert [record.message for record in caplog.records].count(cause.text) == 1
