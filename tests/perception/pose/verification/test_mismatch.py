"""A part whose rib is on the other side: its pose fits nearly everywhere but at the ribs."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from perception.geometry import Floats, rotation_about, transform_points
from perception.part import PartModel
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.model.surface_models import surface_model
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.verification.boundary_index import index_boundary
from perception.pose.verification.mismatch import DEEPEST, OFF, Mismatch, find_mismatch
from perception.pose.verification.verification import ObservedGroup, VerificationConfig
from tests.perception.pose import observed_part as at
from tests.perception.pose.estimator_scene import Scene, quick_estimator, scene_of


def block(size: tuple[float, float, float], centre: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(size).apply_translation(centre)


def ribbed(side: int) -> PartModel:
    """Return a plate with a rib along one side (1 or -1) of its top and a notch at one end."""
    plate = trimesh.boolean.union([block((0.06, 0.04, 0.008), (0, 0, 0)), block(RIB, (0.004, side * 0.0135, 0.0085))])
    return PartModel.from_mesh(
        "ribbed", trimesh.boolean.difference([plate, block((0.014, 0.012, 0.02), (-0.027, 0, 0))])
    )


RIB = (0.046, 0.005, 0.010)
MODEL, MIRRORED = ribbed(1), ribbed(-1)
CONFIG = VerificationConfig()
ESTIMATOR = quick_estimator(MODEL, EstimatorConfig())
TOP = rotation_about((0, 0, 1), 0.4) @ rotation_about((1, 0, 0), np.pi - 0.2)  # the rib towards the camera


def observed(scene: Scene) -> ObservedGroup:
    cloud = scene.boundary
    return ObservedGroup(
        points_cam=cloud.points_cam,
        tangents_cam=cloud.tangents_cam,
        boundary=index_boundary(cloud.points_cam, cloud.tangents_cam, MODEL.d_max),
        frame=scene.frame,
    )


def estimated(part: PartModel, rotation: Floats) -> PoseEstimate:
    """Return what the estimator of the model says about a part in a bin."""
    scene = scene_of(part, at.pose_of(part, rotation))
    (estimate,) = ESTIMATOR.estimate_groups(scene.boundary, scene.groups(), scene.frame)
    assert estimate is not None
    return estimate


@pytest.fixture(scope="module")
def right() -> PoseEstimate:
    return estimated(MODEL, TOP)


@pytest.fixture(scope="module")
def wrong() -> PoseEstimate:
    return estimated(MIRRORED, TOP)


def test_a_mirrored_part_does_not_pass_for_the_part(right: PoseEstimate, wrong: PoseEstimate) -> None:
    """The model lies upside down in the best pose, and the rib stands on its flat side."""
    config = ESTIMATOR.config.confidence
    assert right.score > 0.95
    assert right.mismatch.patch <= config.patch
    assert right.mismatch.stray == 0
    assert wrong.verdict.support > 0.7  # nearly everything else fits
    assert wrong.mismatch.stray > 0.1
    assert wrong.score < 0.5


def test_a_rib_that_the_scene_lacks_is_a_patch_that_was_seen_through() -> None:
    surface = surface_model(MODEL)
    T = at.pose_of(MIRRORED, TOP)
    top = (surface.points[:, 2] > 0.0055) & (surface.normals[:, 2] > 0.9)
    scene = scene_of(MIRRORED, T)
    found = find_mismatch(T, surface, observed(scene), CONFIG)
    assert 0.8 * np.count_nonzero(top) < found.patch < 1.5 * np.count_nonzero(top)
    assert found.stray > 0.1  # the rib on the other side
    same = find_mismatch(T, surface, observed(scene_of(MODEL, T)), CONFIG)
    assert same.patch <= 1
    assert same.stray == 0


@pytest.mark.parametrize(
    ("noise", "patch", "stray"), [(0.0, True, True), (0.001, True, True), (0.002, True, False), (0.004, False, False)]
)
def test_what_the_noise_of_the_depth_explains_is_no_mismatch(noise: float, patch: bool, stray: bool) -> None:
    """The rib is 10 mm high: a gap counts beyond 3 standard deviations of the depth, a boundary point beyond 6."""
    T = at.pose_of(MIRRORED, TOP)
    group = replace(observed(scene_of(MIRRORED, T)), noise=noise)
    found = find_mismatch(T, surface_model(MODEL), group, CONFIG)
    assert (found.patch > 10) == patch
    assert (found.stray > 0.1) == stray


def test_what_covers_the_part_is_no_patch() -> None:
    T = at.pose_of(MODEL, TOP)
    scene = scene_of(MODEL, T)
    group = ObservedGroup(
        points_cam=np.zeros((0, 3)),
        tangents_cam=np.zeros((0, 3)),
        boundary=index_boundary(scene.boundary.points_cam, scene.boundary.tangents_cam, MODEL.d_max),
        frame=at.framed(np.full(at.SIZE[::-1], 0.3, np.float32)),
    )
    assert find_mismatch(T, surface_model(MODEL), group, CONFIG) == Mismatch(patch=0, stray=0.0)


@pytest.mark.parametrize(
    ("height", "beside", "stray"),
    [
        (3 * OFF, 0, 1.0),  # before the plate, off it
        (3 * OFF, 40, 0.0),  # as many beside the plate: another part, which lies across this one
        (0.5, 0, 0.0),  # on the plate
        (-12 * OFF, 0, 0.0),  # behind the part
    ],
)
def test_points_before_the_part_and_off_it_are_stray(height: float, beside: int, stray: float) -> None:
    surface, T = surface_model(MODEL), at.pose_of(MODEL, rotation_about((1, 0, 0), np.pi))
    group = points_over(T, height * surface.spacing, beside)
    share = find_mismatch(T, surface, group, CONFIG).stray
    assert share == pytest.approx(stray * 40 / (40 + beside))


def test_points_far_before_the_part_are_of_something_else() -> None:
    surface, T = surface_model(MODEL), at.pose_of(MODEL, rotation_about((1, 0, 0), np.pi))
    assert find_mismatch(T, surface, points_over(T, 0.9 * DEEPEST * MODEL.d_max, 0), CONFIG).stray == 1.0
    assert find_mismatch(T, surface, points_over(T, 1.1 * DEEPEST * MODEL.d_max, 0), CONFIG).stray == 0.0


def points_over(T: Floats, height: float, beside: int) -> ObservedGroup:
    """Return 40 points at a height over the middle of the plate's bare side [m], and so many 20 mm beside its end."""
    rng = np.random.default_rng(0)
    over = np.column_stack([rng.uniform(-0.01, 0.02, 40), rng.uniform(-0.015, 0.0, 40), np.full(40, 0.004 + height)])
    aside = np.column_stack([np.full(beside, 0.05), rng.uniform(-0.015, 0.0, beside), np.full(beside, 0.004)])
    points_cam = transform_points(T, np.vstack([over, aside]))
    along = np.tile([1.0, 0.0, 0.0], (len(points_cam), 1))
    return ObservedGroup(
        points_cam=points_cam,
        tangents_cam=along,
        boundary=index_boundary(points_cam, along, MODEL.d_max),
        frame=scene_of(MODEL, T).frame,
    )
