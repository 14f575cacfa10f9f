"""Swapped coordinates of the principal point are named, and no other principal point is taken for them."""

from dataclasses import replace

import numpy as np
import pytest

from perception.bin import find_bin, reconcile
from perception.capture import crop_frame
from perception.diagnosis import FrameReport, PoseCounts, diagnose, swapped_centre_cause
from perception.diagnosis.geometry_causes import geometry_causes
from perception.diagnosis.samples import DepthSamples
from perception.diagnosis.setup import Setup
from perception.frame import Frame
from tests.perception.diagnosis import bin_scene as scene

GOOD = scene.good()[0]


def names(report: FrameReport) -> list[str]:
    return [cause.name for cause in report.causes]


def with_centre(frame: Frame, centre: tuple[float, float]) -> Frame:
    K = frame.K.copy()
    K[:2, 2] = centre
    return replace(frame, K=K)


def test_swapped_coordinates_of_the_principal_point_are_named_though_poses_were_found() -> None:
    found = PoseCounts(groups=4, found=4)
    swapped = with_centre(GOOD, (179.5, 239.5))
    for counts in (None, found):
        report = diagnose(swapped, scene.BIN, scene.ELL, poses=counts)
        assert names(report) == ["camera_matrix"]
        text = "principal point (180, 240) px is the middle of an image of 360 x 480 px, but this one has 480 x 360: cx"
        assert text in str(report)
    _, setup = geometry_causes(DepthSamples.of(swapped), Setup.of(swapped, scene.BIN), poses_found=True)
    np.testing.assert_array_equal(setup.K, GOOD.K)
    assert swapped_centre_cause(with_centre(GOOD, (187.0, 235.0)), scene.BIN) is not None  # a decentred lens


def test_a_measured_bin_does_not_hide_a_swapped_principal_point() -> None:
    """The measurement puts the bin where the wrong camera matrix shows it."""
    for frame, said in ((GOOD, []), (with_centre(GOOD, (179.5, 239.5)), ["camera_matrix"])):
        fit = find_bin(frame, scene.BIN.inner_size, scene.BIN)
        assert fit.reliable
        corrected, workspace = reconcile(frame, scene.BIN, fit, "camera")
        cause = swapped_centre_cause(frame, scene.BIN)
        assert ([] if cause is None else [cause.name]) == said
        assert names(diagnose(corrected, workspace, scene.ELL)) == []


@pytest.mark.parametrize(
    "frame",
    [
        GOOD,
        with_centre(GOOD, (250.0, 170.0)),
        crop_frame(GOOD, 120, 0, 360, 240),  # its principal point is the middle of 240 x 360 pixels
        crop_frame(GOOD, 140, 30, 300, 200),  # of 200 x 300; swapped, more of the bin would be in view
        crop_frame(GOOD, 0, 0, 380, 285),
        crop_frame(GOOD, 60, 0, 360, 360),
    ],
    ids=["centred", "decentred", "upper right", "middle right", "upper left", "square"],
)
def test_centred_decentred_and_cropped_cameras_are_not_taken_for_swapped_ones(frame: Frame) -> None:
    assert swapped_centre_cause(frame, scene.BIN) is None
    assert "camera_matrix" not in names(diagnose(frame, scene.BIN, scene.ELL, poses=PoseCounts(groups=4, found=4)))


def test_without_a_bins_place_a_swapped_principal_point_is_told_by_itself_alone() -> None:
    assert swapped_centre_cause(GOOD, None) is None
    assert swapped_centre_cause(with_centre(GOOD, (187.0, 235.0)), None) is None
    cause = swapped_centre_cause(with_centre(GOOD, (180.0, 240.0)), None)
    assert cause is not None
    assert "swap K[0, 2] and K[1, 2] (in --calibration on the command line), unless this image was cut" in cause.text
