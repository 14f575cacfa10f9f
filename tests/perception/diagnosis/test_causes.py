"""Each cause is found in one good frame that was spoiled in one way, and no other cause is."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from perception.capture import crop_frame
from perception.diagnosis import FrameReport, PoseCounts, diagnose, log
from perception.diagnosis.geometry_causes import geometry_causes
from perception.diagnosis.samples import DepthSamples
from perception.diagnosis.setup import Setup
from perception.frame import Frame, Workspace
from perception.geometry import invert_transform, make_transform, ray_lengths, rotation_about
from perception.part import PartModel
from perception.pipeline import perceive_by
from tests.perception.diagnosis import bin_scene as scene
from tests.perception.pose.estimator_scene import quick_estimator

GOOD = scene.good()[0]
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
ESTIMATOR = quick_estimator(scene.ELL)
CORRECTED = ("depth_unit", "camera_matrix", "camera_axes", "camera_inverted", "inner_size_unit")
HALF = np.diag([0.5, 0.5, 1.0])


def bin_moved(z: float, tilt: float = 0.0) -> Workspace:
    moved = make_transform(rotation_about((1, 0, 0), tilt), (0.0, 0.0, z))
    return replace(scene.BIN, T_world_bin=scene.BIN.T_world_bin @ moved)


def holes_at(value: float) -> np.ndarray:
    return np.where(GOOD.depth == 0, np.float32(value), GOOD.depth)


def smaller(factor: float) -> Frame:
    """Return the frame of a camera of fewer pixels."""
    size = tuple(int(factor * n) for n in scene.SIZE)
    K = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1]]) @ GOOD.K
    grey, depth = (cv2.resize(a, size, interpolation=cv2.INTER_NEAREST) for a in (GOOD.grey, GOOD.depth))
    return Frame(grey=grey, depth=depth, K=K, T_world_cam=GOOD.T_world_cam)


def plain(frame: Frame) -> np.ndarray:
    """Return a grey image without any edge."""
    grey = np.full_like(frame.grey, 120)
    grey[:, 0] = 121
    return grey


SPOILED: dict[str, tuple[Callable[[], tuple[Frame, Workspace]], list[str], str]] = {
    "depth in millimetres": (
        lambda: (replace(GOOD, depth=1000 * GOOD.depth), scene.BIN),
        ["depth_unit"],
        "seems to be in millimetres; multiply it by 0.001",
    ),
    "depth in tenths of a millimetre": (
        lambda: (replace(GOOD, depth=10_000 * GOOD.depth), scene.BIN),
        ["depth_unit"],
        "seems to be in tenths of a millimetre; multiply it by 0.0001",
    ),
    "depth in centimetres": (
        lambda: (replace(GOOD, depth=100 * GOOD.depth), scene.BIN),
        ["depth_unit"],
        "seems to be in centimetres; multiply it by 0.01",
    ),
    "depth in inches": (
        lambda: (replace(GOOD, depth=GOOD.depth / np.float32(0.0254)), scene.BIN),
        ["depth_unit"],
        "seems to be in inches; multiply it by 0.0254",
    ),
    "depth in feet": (
        lambda: (replace(GOOD, depth=GOOD.depth / np.float32(0.3048)), scene.BIN),
        ["depth_unit"],
        "seems to be in feet; multiply it by 0.3048",
    ),
    "depth divided twice": (
        lambda: (replace(GOOD, depth=GOOD.depth / 1000), scene.BIN),
        ["depth_unit"],
        "seems to have been divided by 1000 once too often; multiply it by 1000",
    ),
    "K of a larger image": (
        lambda: (replace(GOOD, K=np.diag([2.0, 2.0, 1.0]) @ GOOD.K), scene.BIN),
        ["camera_matrix"],
        "is the middle of an image of about 959 x 719 px, but this one has 480 x 360: K seems to be that of another",
    ),
    "K of a smaller image": (
        lambda: (replace(GOOD, K=HALF @ GOOD.K), scene.BIN),
        ["camera_matrix"],
        "multiply its first row by 2 and its second by 2",
    ),
    "OpenGL axes": (
        lambda: (replace(GOOD, T_world_cam=GOOD.T_world_cam @ OPENGL), scene.BIN),
        ["camera_axes"],
        "use T_world_cam @ diag(1, -1, -1, 1)",
    ),
    "inverted": (
        lambda: (replace(GOOD, T_world_cam=invert_transform(GOOD.T_world_cam)), scene.BIN),
        ["camera_inverted"],
        "T_world_cam seems to be its inverse, which maps the world to the camera; invert it",
    ),
    "inverted, OpenGL axes": (
        lambda: (replace(GOOD, T_world_cam=invert_transform(GOOD.T_world_cam @ OPENGL)), scene.BIN),
        ["camera_inverted"],
        "use inv(T_world_cam) @ diag(1, -1, -1, 1)",
    ),
    "bin at the origin": (
        lambda: (GOOD, replace(scene.BIN, T_world_bin=np.eye(4))),
        ["bin_pose"],
        "the bin stands at the origin of the world (T_world_bin is the identity), but",
    ),
    "bin elsewhere": (
        lambda: (GOOD, bin_moved(0.2)),
        ["bin_pose"],
        "the frame shows no bin where it should be",
    ),
    "inner_size in millimetres": (
        lambda: (GOOD, replace(scene.BIN, inner_size=1000 * scene.BIN.inner_size)),
        ["inner_size_unit"],
        "inner_size is 240 x 180 x 80 m: it seems to be in millimetres; divide it by 1000",
    ),
    "inner_size in centimetres": (
        lambda: (GOOD, replace(scene.BIN, inner_size=100 * scene.BIN.inner_size)),
        ["inner_size_unit"],
        "inner_size is 24 x 18 x 8 m: it seems to be in centimetres; divide it by 100 (--bin 240x180x80 on the command",
    ),
    "inner_size in inches": (
        lambda: (GOOD, replace(scene.BIN, inner_size=scene.BIN.inner_size / 0.0254)),
        ["inner_size_unit"],
        "inner_size is 9.44882 x 7.08661 x 3.14961 m: it seems to be in inches; divide it by 39.37 (--bin 240x180x80",
    ),
    "bin turned over": (
        lambda: (GOOD, replace(scene.BIN, T_world_bin=scene.BIN.T_world_bin @ OPENGL)),
        ["bin_pose"],
        "the z axis of T_world_bin points away from the camera, but must point up, out of the bin: use T_world_bin @",
    ),
    "underexposed": (
        lambda: (replace(GOOD, grey=(GOOD.grey / 10).astype(np.uint8)), scene.BIN),
        ["underexposed"],
        "is darker than grey level 16 of 255: the image is underexposed",
    ),
    "overexposed": (
        lambda: (replace(GOOD, grey=np.clip(5.0 * GOOD.grey, 0, 255).astype(np.uint8)), scene.BIN),
        ["overexposed"],
        "the image is overexposed and contours are lost",
    ),
    "65535 for nothing": (
        lambda: (replace(GOOD, depth=holes_at(65.535)), scene.BIN),
        ["missing_depth"],
        "have exactly the depth 65.535 m, far from all others: it seems to stand for no measurement; set these pixels",
    ),
    "0.001 for nothing": (
        lambda: (replace(GOOD, depth=holes_at(0.001)), scene.BIN),
        ["missing_depth"],
        "have exactly the depth 0.001 m",
    ),
    "65535 for nothing, in millimetres": (
        lambda: (replace(GOOD, depth=1000 * holes_at(65.535)), scene.BIN),
        ["depth_unit", "missing_depth"],
        "have exactly the depth 65535 m",
    ),
    "two thirds of the pixels": (
        lambda: (smaller(2 / 3), scene.BIN),
        ["few_pixels"],
        "a part is only about 62 pixels long, 70 are needed: move the camera nearer",
    ),
    "a third of the pixels": (
        lambda: (smaller(1 / 3), scene.BIN),
        ["few_pixels"],
        "a part is only about 31 pixels long, 70 are needed (under 45 the segmentation splits parts)",
    ),
    "bin 6 mm high": (
        lambda: (GOOD, bin_moved(0.006)),
        ["floor_height"],
        "and the floor rejected the best poses of 4 of 4 groups: the bin seems to stand lower than",
    ),
    "bin 12 mm high": (
        lambda: (GOOD, bin_moved(0.012)),
        ["floor_height"],
        "a quarter of what is measured in the bin lies 12 mm or more below its floor",
    ),
    "bin 25 mm high": (
        lambda: (GOOD, bin_moved(0.025)),
        ["floor_height"],
        "a quarter of what is measured in the bin lies 25 mm or more below its floor",
    ),
    "distance from the camera's centre": (
        lambda: (replace(GOOD, depth=distances()), scene.BIN),
        ["depth_range"],
        "times as level if it is taken for the distance from the camera's centre",
    ),
    "no depth": (
        lambda: (replace(GOOD, depth=np.zeros_like(GOOD.depth)), scene.BIN),
        ["no_depth"],
        "no pixel has a depth",
    ),
    "no depth in the bin": (
        lambda: (replace(GOOD, depth=np.where(scene.in_bin(), np.float32(0), GOOD.depth)), scene.BIN),
        ["no_depth"],
        "hardly any pixel of the bin has a depth",
    ),
    # Frames that are as good: nothing is found.
    "good": (lambda: (GOOD, scene.BIN), [], "no likely cause of lost parts"),
    "noisy": (lambda: (replace(GOOD, depth=noisy()), scene.BIN), [], "no likely cause of lost parts"),
    "bin 3 mm low": (lambda: (GOOD, bin_moved(-0.003)), [], "no likely cause of lost parts"),
    "darker": (lambda: (replace(GOOD, grey=GOOD.grey // 2), scene.BIN), [], "no likely cause of lost parts"),
    "camera in the bin": (
        lambda: (GOOD, replace(bin_moved(-scene.TABLE), inner_size=np.array([1.2, 1.0, 0.8]))),
        [],
        "no likely cause of lost parts",
    ),
    "empty, and a third of the pixels": (
        lambda: (replace(smaller(1 / 3), grey=plain(smaller(1 / 3))), scene.BIN),
        [],
        "no likely cause of lost parts",
    ),
    "half of the bin": (
        lambda: (right_half(), scene.BIN),
        ["partly_outside"],
        "% of the bin's image lies within the frame: parts beside it are not found",
    ),
    "upper left of the image": (lambda: (cropped(), scene.BIN), [], "no likely cause of lost parts"),
}


IN_PARTS = ("of the pixels", "upper left", "half of the bin")  # frames in which the true groups are other pixels


def noisy() -> np.ndarray:
    noise = 0.001 * np.random.default_rng(1).normal(size=GOOD.depth.shape).astype(np.float32)
    return np.where(GOOD.depth > 0, GOOD.depth + noise, 0)


def distances() -> np.ndarray:
    u, v = np.arange(scene.SIZE[0]), np.arange(scene.SIZE[1])
    return (GOOD.depth * ray_lengths(GOOD.K, u, v)).astype(np.float32)


def right_half() -> Frame:
    height, width = GOOD.depth.shape
    return crop_frame(GOOD, width // 2, 0, width // 2, height)


def cropped() -> Frame:
    return replace(GOOD, grey=GOOD.grey[:285, :380].copy(), depth=GOOD.depth[:285, :380].copy())


def names(report: FrameReport) -> list[str]:
    return [cause.name for cause in report.causes]


@pytest.mark.parametrize("name", [name for name in SPOILED if name != "bin 6 mm high"])
def test_a_spoiled_frame_names_its_cause_and_no_other(name: str) -> None:
    spoil, causes, text = SPOILED[name]
    report = diagnose(*spoil(), scene.ELL)
    assert names(report) == causes
    assert text in str(report)


@pytest.mark.parametrize("name", [name for name in SPOILED if not any(each in name for each in IN_PARTS)])
def test_the_pipeline_names_the_same_causes(name: str) -> None:
    spoil, causes, text = SPOILED[name]
    frame, workspace = spoil()
    ESTIMATOR.workspace = workspace
    report = perceive_by(scene.true_groups, ESTIMATOR, frame, workspace).report
    assert report is not None
    assert report.poses is not None
    assert names(report) == causes
    assert text in str(report)
    harmless = ([], ["missing_depth"], ["inner_size_unit"], ["overexposed"])  # saturated throughout: depth edges alone
    assert report.poses.found == (4 if causes in harmless else 0)


def test_a_part_as_thin_as_the_noise_is_named() -> None:
    rng = np.random.default_rng(0)
    noisy = np.where(GOOD.depth > 0, GOOD.depth + 0.0015 * rng.normal(size=GOOD.depth.shape), 0).astype(np.float32)
    plate = PartModel.from_mesh("plate", trimesh.creation.box((0.06, 0.04, 0.002)))
    report = diagnose(replace(GOOD, depth=noisy), scene.BIN, plate)
    assert names(report) == ["thin_part"]
    assert "the part is 2 mm thick, and the noise of the depth is 1." in str(report)
    assert "mm: parts that lie flat on the floor hardly stand out from it" in str(report)
    assert names(diagnose(GOOD, scene.BIN, plate)) == []


def test_poses_that_were_found_exclude_a_wrong_camera_matrix() -> None:
    frame = replace(GOOD, K=HALF @ GOOD.K)
    found = PoseCounts(groups=4, found=2, by_score=2)
    assert "camera_matrix" in names(diagnose(frame, scene.BIN, scene.ELL))
    assert "camera_matrix" not in names(diagnose(frame, scene.BIN, scene.ELL, poses=found))


@pytest.mark.parametrize(
    ("counts", "causes"),
    [
        (PoseCounts(groups=20, found=5, by_floor=7, by_score=8), []),
        (PoseCounts(groups=20, found=5, by_floor=8, by_score=7), ["floor_height"]),
        (PoseCounts(groups=20, found=11, by_floor=9), []),
        (PoseCounts(groups=20, found=5, by_walls=15), []),
        (PoseCounts(groups=3, by_floor=2, without_pose=1), []),
        (PoseCounts(groups=3, by_floor=3), ["floor_height"]),
    ],
)
def test_the_floor_is_suspected_if_it_rejects_a_high_share_of_poses(counts: PoseCounts, causes: list[str]) -> None:
    assert names(diagnose(GOOD, scene.BIN, scene.ELL, poses=counts)) == causes


def test_the_pipeline_logs_each_cause_once(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "_logged", set())
    ESTIMATOR.workspace = scene.BIN
    spoiled = replace(GOOD, depth=1000 * GOOD.depth)
    for frame in (GOOD, spoiled, spoiled):
        perceive_by(scene.true_groups, ESTIMATOR, frame, scene.BIN)
    (record,) = caplog.records
    assert "the depth seems to be in millimetres" in record.message


@pytest.mark.parametrize(
    "name", [name for name, (_, causes, _) in SPOILED.items() if causes and causes[0] in CORRECTED]
)
def test_the_corrected_setup_is_the_true_one(name: str) -> None:
    frame, workspace = SPOILED[name][0]()
    given = Setup(
        K=frame.K,
        T_world_cam=frame.T_world_cam,
        T_world_bin=workspace.T_world_bin,
        inner_size=workspace.inner_size,
    )
    _, setup = geometry_causes(DepthSamples.of(frame), given, poses_found=False)
    np.testing.assert_allclose(setup.K, GOOD.K, rtol=0.01)
    np.testing.assert_allclose(setup.T_world_cam, GOOD.T_world_cam, atol=1e-12)
    np.testing.assert_allclose(setup.inner_size, scene.BIN.inner_size)
    scales = {"millimetres": 1e-3, "tenths of": 1e-4, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048}
    scales["divided"] = 1e3
    said = [scale for words, scale in scales.items() if words in name and "inner_size" not in name]
    assert setup.scale == (said[0] if said else 1.0)
