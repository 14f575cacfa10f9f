"""Samples of a part's surface."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from perception.part import PartModel
from perception.pose.model.surface_models import surface_model
from tests.perception.pose import observed_part as at

ELL = at.ell()
SURFACE = surface_model(ELL)


def test_samples_lie_on_the_surface_evenly() -> None:
    assert ELL.mesh.area * 0.5 < len(SURFACE.points) * SURFACE.spacing**2 < ELL.mesh.area * 1.2
    triangles = np.asarray(ELL.mesh.triangles)
    pairs = np.repeat(triangles, len(SURFACE.points), axis=0), np.tile(SURFACE.points, (len(triangles), 1))
    distance = np.linalg.norm(trimesh.triangles.closest_point(*pairs) - pairs[1], axis=1).reshape(len(triangles), -1)
    assert distance.min(axis=0).max() < 1e-9
    assert np.linalg.norm(ELL.mesh.face_normals[distance.argmin(axis=0)] - SURFACE.normals, axis=1).max() < 1e-9
    assert SURFACE.spacing == pytest.approx(0.03 * ELL.d_max)
    apart = np.linalg.norm(SURFACE.points[:, None] - SURFACE.points, axis=-1)
    alike = SURFACE.normals @ SURFACE.normals.T > 0.99
    assert apart[alike & ~np.eye(len(apart), dtype=bool)].min() > SURFACE.spacing
    reached = np.linalg.norm(ELL.mesh.triangles_center[:, None] - SURFACE.points, axis=-1).min(axis=1)
    assert reached.max() < 1.5 * SURFACE.spacing


def test_both_sides_of_a_thin_plate_are_sampled() -> None:
    plate = surface_model(PartModel.from_mesh("sheet", trimesh.creation.box((0.06, 0.04, 0.0005))))
    up, down = (np.count_nonzero(plate.normals[:, 2] * s > 0.9) for s in (1, -1))
    assert min(up, down) > 0.85 * max(up, down)
    assert min(up, down) * plate.spacing**2 > 0.6 * 0.06 * 0.04


def test_the_samples_are_the_same_every_time() -> None:
    again = surface_model(at.ell())
    assert again.points.tobytes() == SURFACE.points.tobytes()


def test_a_bad_surface_is_refused() -> None:
    with pytest.raises(ValueError, match="spacing must be between 0 and 1, got 0"):
        surface_model(ELL, 0.0)
    with pytest.raises(ValueError, match="spacing and d_max must be positive, got -1"):
        replace(SURFACE, spacing=-1.0)
    with pytest.raises(ValueError, match="normals must be"):
        replace(SURFACE, normals=SURFACE.normals[1:])
