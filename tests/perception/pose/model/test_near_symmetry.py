"""The motions after which a part looks nearly the same."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh

from perception.geometry import Floats, make_transform, rotation_about, rotation_angle
from perception.part import PartModel, Symmetry
from perception.pose.model.near_symmetry import NearSymmetryConfig, near_symmetries
from perception.pose.model.surface_models import surface_model


def block(*extents: float, cut: float = 0.0, symmetry: Symmetry | None = None) -> PartModel:
    """Return a block, with a small cube set on a corner of its top if ``cut`` is its side [m]."""
    mesh = trimesh.creation.box(extents)
    if cut:
        corner = np.array(extents) / 2 - cut / 2
        lump = trimesh.creation.box(
            (cut, cut, cut), trimesh.transformations.translation_matrix(corner + np.array([0, 0, cut]))
        )
        mesh = trimesh.boolean.union([mesh, lump])
    return PartModel.from_mesh("block", mesh, symmetry)


def half_turns() -> Symmetry:
    return Symmetry(rotations=np.array([np.diag(d) for d in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])], float))


def test_a_block_with_a_lump_has_its_half_turns_for_near_symmetries() -> None:
    part = block(0.08, 0.05, 0.03, cut=0.006)
    found = near_symmetries(part, surface_model(part))
    assert len(found) == 3
    for T in found:
        assert np.degrees(rotation_angle(T[:3, :3])) == pytest.approx(180, abs=5)
        axis = np.abs(np.linalg.eigh(T[:3, :3] + T[:3, :3].T)[1][:, -1])
        assert axis.max() > 0.99  # the block's own axes


def test_near_symmetries_lay_the_surface_on_itself() -> None:
    part = block(0.08, 0.05, 0.03, cut=0.006)
    surface = surface_model(part)
    for T in near_symmetries(part, surface):
        moved = surface.points @ T[:3, :3].T + T[:3, 3]
        _, distances, _ = trimesh.proximity.closest_point_naive(part.mesh, moved[::7])
        assert distances.mean() < 0.01 * part.d_max


def gap(part: PartModel, T: Floats) -> float:
    """Return the mean distance of the moved part's surface from the part [m]."""
    surface = surface_model(part)
    moved = surface.points @ T[:3, :3].T + T[:3, 3]
    return float(trimesh.proximity.closest_point_naive(part.mesh, moved[::3])[1].mean())


def test_a_registered_motion_lies_better_than_the_rotation_it_began_as() -> None:
    part = block(0.08, 0.05, 0.03, cut=0.016)  # its lump draws the centre aside
    axes = np.asarray(part.mesh.principal_inertia_vectors)
    for T in near_symmetries(part, surface_model(part)):
        turns = [rotation_about(axis, np.pi) for axis in axes]
        turn = min(turns, key=lambda turn: rotation_angle(turn.T @ T[:3, :3]))
        assert gap(part, T) < 0.95 * gap(part, make_transform(turn, part.centre - turn @ part.centre))


@pytest.mark.slow
def test_the_most_alike_come_first() -> None:
    part = block(0.08, 0.05, 0.047, cut=0.012)
    gaps = [gap(part, T) for T in near_symmetries(part, surface_model(part), NearSymmetryConfig(most=8, distance=0.1))]
    assert len(gaps) > 3
    assert gaps[-1] > 1.2 * gaps[0]
    assert all(after > 0.9 * before for before, after in pairwise(gaps))


def test_symmetries_are_no_near_symmetries() -> None:
    part = block(0.08, 0.05, 0.03, symmetry=half_turns())
    assert len(near_symmetries(part, surface_model(part))) == 0


def test_undeclared_symmetries_are_near_symmetries() -> None:
    part = block(0.08, 0.05, 0.03)
    assert len(near_symmetries(part, surface_model(part))) == 3


def test_as_many_near_symmetries_as_are_asked_for_the_closest_first() -> None:
    part = block(0.08, 0.05, 0.03, cut=0.006)
    surface = surface_model(part)
    every = near_symmetries(part, surface)
    np.testing.assert_array_equal(near_symmetries(part, surface, NearSymmetryConfig(most=2)), every[:2])
    assert near_symmetries(part, surface, NearSymmetryConfig(most=0)).shape == (0, 4, 4)


def test_a_part_that_looks_different_from_every_side_has_none() -> None:
    part = block(0.08, 0.05, 0.03, cut=0.006)
    assert len(near_symmetries(part, surface_model(part), NearSymmetryConfig(distance=1e-4))) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"most": -1}, "most must not be negative, got -1"),
        ({"distance": 0.0}, "distance must be positive, got 0.0"),
        ({"lead": float("nan")}, "lead must be positive, got nan"),
    ],
)
def test_nonsense_is_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        NearSymmetryConfig(**change)  # type: ignore[arg-type]
