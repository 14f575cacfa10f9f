"""Turns of parts whose surface is known to stay or to move."""

import numpy as np
import pytest
import trimesh

from perception.geometry import Floats, make_transform, random_rotation, rotation_about
from perception.part import PartModel
from perception.pose.model.surface_models import surface_model
from perception.pose.verification.same_surface import DISTANCE, SHARE, SameSurface

LENGTH, RADIUS = 0.06, 0.02


def pin() -> PartModel:
    """A pin with a hole across: its turn about the axis moves a small part of its surface."""
    body = trimesh.creation.cylinder(RADIUS, LENGTH, sections=64)
    hole = trimesh.creation.cylinder(0.006, 0.1, sections=24)
    hole.apply_transform(make_transform(rotation_about((0.0, 1.0, 0.0), np.pi / 2), np.array([0.0, 0.0, 0.02])))
    return PartModel.from_mesh("pin", trimesh.boolean.difference([body, hole], engine="manifold"))


SAME = SameSurface(surface_model(pin()))


def turned(T: Floats, axis: tuple[float, float, float], degrees: float) -> Floats:
    return T @ make_transform(rotation_about(axis, np.radians(degrees)))


def test_a_turn_about_the_axis_leaves_the_surface_and_a_tilt_does_not() -> None:
    T = make_transform(random_rotation(np.random.default_rng(0)), np.array([0.1, 0.2, 0.9]))
    turns = [turned(T, (0.0, 0.0, 1.0), angle) for angle in (0.0, 10.0, 90.0, 200.0)]
    tilts = [turned(T, (1.0, 0.0, 0.0), angle) for angle in (20.0, 90.0)]
    assert SAME.of(T, np.array([*turns, *tilts])).tolist() == [True] * 4 + [False] * 2


@pytest.mark.parametrize(("shift", "same"), [(0.5, True), (3.0, False)])
def test_a_shift_within_the_distance_leaves_the_surface(shift: float, same: bool) -> None:
    d_max = surface_model(pin()).d_max
    T = make_transform(translation=(0.0, 0.0, 1.0))
    sideways = T @ make_transform(translation=(shift * DISTANCE * d_max, 0.0, 0.0))
    assert SAME.of(T, np.array([sideways])).tolist() == [same]


@pytest.mark.parametrize(("share", "same"), [(0.15, True), (0.2, False)])
def test_a_slim_rod_may_shift_along_its_axis(share: float, same: bool) -> None:
    surface = surface_model(PartModel.from_mesh("rod", trimesh.creation.cylinder(0.004, 0.08, sections=48)))
    shifted = make_transform(translation=(0.0, 0.0, share * surface.d_max))
    assert SameSurface(surface).of(np.eye(4), shifted[None]).tolist() == [same]


def test_a_face_that_looks_the_other_way_is_another_one() -> None:
    """A thin plate that is moved by its thickness has its back where its front was."""
    thickness = 0.002
    plate = SameSurface(surface_model(PartModel.from_mesh("plate", trimesh.creation.box((0.05, 0.04, thickness)))))
    T = np.eye(4)
    assert plate.of(T, T[None]).all()
    assert not plate.of(T, make_transform(translation=(0.0, 0.0, thickness + DISTANCE * 0.07))[None]).any()


def test_without_other_poses_there_is_nothing_to_tell() -> None:
    assert SAME.of(np.eye(4), np.zeros((0, 4, 4))).shape == (0,)
    assert 0 < SHARE < 1
