"""Whether a refined bin can be believed: each reason against it, from a bin that can."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from perception.bin.cloud import GridCloud
from perception.bin.first_guess import Prior
from perception.bin.judgement import why_unreliable
from perception.bin.refinement import WALLS, BinState, Refined
from perception.geometry import Floats, invert_transform, make_transform, rotation_about, transform_points
from tests.perception.bin import box_scene as scene

T_CAM_BIN = make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.8))  # straight below the camera
SURFACES = ("floor", "rim", *WALLS)
PRIOR = Prior(inner_size=scene.INNER, T_cam_bin=T_CAM_BIN, extent=scene.INNER[:2])
REFINED = Refined(
    state=BinState(T_cam_bin=T_CAM_BIN, size=scene.INNER),
    points=dict.fromkeys(SURFACES, 100),
    residual=0.0003,
    covariance=np.diag([0.0003**2] * 6),
)


def measured(depth_below: float = 0.0, share_below: float = 0.0) -> GridCloud:
    """Return points all over the floor, a share of them below it, and as many beside the bin and deep below it."""
    rng = np.random.default_rng(0)
    points_bin = rng.uniform(-0.5, 0.5, (1000, 3)) * (0.34, 0.24, 0.0)
    points_bin[: round(1000 * share_below), 2] = -depth_below
    points_bin = np.concatenate([points_bin, points_bin + np.array([1.0, 0.0, -0.3])])
    return GridCloud(
        points_cam=transform_points(T_CAM_BIN, points_bin),
        cells=np.arange(len(points_bin)),
        shape=(40, 50),
        step=1,
        K=scene.K,
    )


def judged(refined: Refined = REFINED, cloud: GridCloud | None = None, prior: Prior = PRIOR) -> str | None:
    return why_unreliable(refined, scene.INNER[:2], cloud or measured(), prior)


def without(*names: str) -> Refined:
    return replace(REFINED, points={name: 0 if name in names else 100 for name in SURFACES})


def test_a_bin_that_is_seen_well_is_believed() -> None:
    assert judged() is None


@pytest.mark.parametrize(
    ("unseen", "reason"),
    [
        (("floor", "rim"), "neither its floor nor its rim is seen"),
        (("floor",), None),
        (("rim",), None),
        (("wall_y+", "wall_y-"), "only the walls at the ends of its length are seen"),
        (("wall_x+", "wall_x-"), "only the walls at the ends of its width are seen"),
        (("wall_x+", "wall_y-"), None),
        (WALLS, None),
    ],
)
def test_surfaces_that_do_not_tell_a_pose_are_named(unseen: tuple[str, ...], reason: str | None) -> None:
    assert judged(without(*unseen)) == reason


@pytest.mark.parametrize(
    ("std", "reason"),
    [
        ({0: 0.0028}, None),
        ({0: 0.0032}, "too little of it is seen: its pose is uncertain by 3.2 mm and 0.02 degrees"),
        ({5: np.deg2rad(0.65)}, None),
        ({5: np.deg2rad(0.75)}, "too little of it is seen: its pose is uncertain by 0.4 mm and 0.75 degrees"),
    ],
)
def test_an_uncertain_pose_is_not_believed(std: Mapping[int, float], reason: str | None) -> None:
    covariance = REFINED.covariance.copy()
    for axis, value in std.items():
        covariance[axis, axis] = value**2
    assert judged(replace(REFINED, covariance=covariance)) == reason


@pytest.mark.parametrize(
    ("T_bin_believed", "reason"),
    [
        (make_transform(translation=(0.14, 0.0, 0.0)), None),
        (make_transform(translation=(0.16, 0.0, 0.0)), "what looks like it lies 160 mm and 0 degrees from where"),
        (make_transform(rotation_about((0, 0, 1), np.deg2rad(14))), None),
        (make_transform(rotation_about((0, 0, 1), np.deg2rad(16))), "what looks like it lies 0 mm and 16 degrees from"),
    ],
)
def test_a_bin_far_from_where_it_is_believed_is_another_one(T_bin_believed: Floats, reason: str | None) -> None:
    found = judged(prior=replace(PRIOR, T_cam_bin=T_CAM_BIN @ invert_transform(T_bin_believed)))
    if reason is None:
        assert found is None
    else:
        assert found is not None
        assert found.startswith(reason)


@pytest.mark.parametrize(
    ("depth_below", "share_below", "reason"),
    [
        (0.007, 0.2, "20 % of what is measured in it lies below its floor"),
        (0.005, 0.2, None),
        (0.007, 0.05, None),
    ],
)
def test_a_bin_with_much_below_its_floor_is_not_believed(
    depth_below: float, share_below: float, reason: str | None
) -> None:
    assert judged(cloud=measured(depth_below, share_below)) == reason
