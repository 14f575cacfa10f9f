"""Edge models: solids whose visible edges are counted by hand, and an image drawn ray by ray."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree

from perception.pose.model.edge_models import EdgeModelConfig, edge_model
from perception.pose.model.viewpoints import view_directions
from tests.perception.pose.model.edge_parts import (
    BACK,
    CORNER,
    DOWN,
    FRONT,
    UP,
    VIEWS_OF_X,
    a_part,
    boss_on_plate,
    bracket,
    cube,
    edges_seen,
    prism,
    stepped,
)
from tests.reference.edge_models_twin import image_edges, unoccluded


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_views_are_unit_nested_and_come_in_opposite_pairs() -> None:
    views = view_directions(26)
    assert_allclose(np.linalg.norm(views, axis=1), 1.0)
    assert len(np.unique(views.round(9), axis=0)) == 26
    for count in (1, 6, 14):
        assert_array_equal(view_directions(count), views[:count])
    assert_allclose(np.sort(views, axis=0), np.sort(-views, axis=0))
    for view, direction in VIEWS_OF_X.items():
        assert_allclose(views[view], np.array(direction) / np.linalg.norm(direction))


@pytest.mark.parametrize("count", [0, 7, 32])
def test_other_numbers_of_views_are_refused(count: Any) -> None:
    with pytest.raises(ValueError, match=rf"views must be one of \[1, 6, 14, 26\], got {count}"):
        view_directions(count)


@pytest.mark.parametrize("distance", [3.0, 10.0, np.inf])
def test_a_cube_shows_4_edges_to_a_face_view_and_9_to_a_corner_view(distance: float) -> None:
    model = edge_model(cube(), EdgeModelConfig(distance=distance))
    for view in range(6):
        assert edges_seen(model, view) == 4
    for view in range(6, 14):
        assert edges_seen(model, view) == 9


def test_a_cube_shows_7_edges_to_a_view_on_an_edge() -> None:
    model = edge_model(cube(), EdgeModelConfig(views=26))
    assert [edges_seen(model, view) for view in range(14, 26)] == [7] * 12


def test_points_of_a_cube_lie_on_its_edges_with_their_tangents() -> None:
    model = edge_model(cube())
    assert_allclose(np.sort(np.abs(model.points), axis=1)[:, 1:], 0.02, atol=1e-12)
    along = np.argmin(np.abs(model.points), axis=1)
    assert_allclose(np.abs(model.tangents), np.eye(3)[along], atol=1e-12)


def test_every_place_of_every_edge_has_a_point_within_the_thinning() -> None:
    model = edge_model(cube())
    ticks = np.linspace(-0.02, 0.02, 101)
    radius = 0.025 * model.d_max
    for axis in range(3):
        for a in (-0.02, 0.02):
            for b in (-0.02, 0.02):
                line = np.insert(np.tile([a, b], (101, 1)), axis, ticks, axis=1)
                own = model.points[np.abs(model.tangents[:, axis]) > 0.99]
                assert cKDTree(own).query(line)[0].max() <= 1.2 * radius
                on_line = own[np.linalg.norm(np.delete(own, axis, axis=1) - [a, b], axis=1) < 1e-9]
                steps = np.diff(np.sort(on_line[:, axis]))
                assert steps.min() > radius * 0.99
                assert steps.max() < radius * 1.3


def test_the_near_face_is_the_one_of_the_view() -> None:
    model = edge_model(cube())
    for view in range(6):
        heights = model.points[model.visible_in(view)] @ model.views[view]
        assert_allclose(heights, 0.02, atol=1e-12)


def test_a_cylinder_has_two_circles_and_silhouettes_but_no_facets() -> None:
    part = a_part(trimesh.creation.cylinder(radius=0.02, height=0.06, sections=32))
    model = edge_model(part, EdgeModelConfig(inset=0.0))
    rim = np.abs(np.abs(model.points[:, 2]) - 0.03) < 1e-9
    assert_allclose(np.abs(model.tangents[rim, 2]), 0.0, atol=1e-9)
    assert_allclose(np.abs(model.tangents[~rim, 2]), 1.0, atol=1e-9)
    from_x = ~rim & model.visible_in(FRONT)
    assert np.all(np.abs(model.points[from_x, 1]) > 0.02 * np.cos(2 * np.pi / 32))
    assert len(np.unique(model.points[from_x, 1].round(6))) == 2
    assert np.all(rim[model.visible_in(UP)])
    assert_allclose(model.points[model.visible_in(UP), 2], 0.03)
    occluded = rim & (model.points[:, 2] < 0) & (model.points[:, :2].sum(axis=1) < -0.01)
    assert occluded.sum() > 10
    assert not np.any(model.visible_in(CORNER)[occluded])


def test_the_silhouette_of_a_ball_is_a_great_circle_with_its_direction() -> None:
    ball = a_part(trimesh.creation.icosphere(subdivisions=4, radius=0.03))
    model = edge_model(ball, EdgeModelConfig(distance=np.inf, inset=0.0))
    assert model.visibility.min() > 0
    for view in range(14):
        seen = model.visible_in(view)
        radial, tangents = model.points[seen] / 0.03, model.tangents[seen]
        assert np.abs(radial @ model.views[view]).max() < 0.1
        # On the mesh the line zigzags by up to 60 degrees.
        off = np.abs(np.einsum("ci,ci->c", tangents, np.cross(radial, model.views[view])))
        assert np.rad2deg(np.arccos(np.minimum(off, 1))).max() < 25
        angle = np.sort(np.arctan2(*(radial @ np.linalg.svd(model.views[view][None])[2][1:].T).T))
        assert np.diff(angle).max() < 2.5 * 0.025 * 2


def test_points_of_a_curved_silhouette_lie_inside_it_by_the_inset() -> None:
    radius, inset = 0.02, 0.05
    part = a_part(trimesh.creation.cylinder(radius=radius, height=0.06, sections=64))
    model = edge_model(part, EdgeModelConfig(distance=np.inf, inset=inset))
    sides = np.abs(np.abs(model.points[:, 2]) - 0.03) > 1e-6
    seen = model.points[sides & model.visible_in(FRONT)]
    assert_allclose(np.abs(seen[:, 1]), radius - inset * part.d_max, atol=0.01 * radius)
    assert_allclose(np.linalg.norm(seen[:, :2], axis=1), radius, rtol=0.005)
    assert np.all(seen[:, 0] > 0)
    assert set(np.sign(seen[:, 1])) == {-1.0, 1.0}
    assert np.all(model.points[sides & model.visible_in(BACK), 0] < 0)


def test_an_inset_that_leaves_the_curved_surface_is_not_taken() -> None:
    # A rod of 1 mm lies in front of a far cylinder's silhouette, and the inset crosses the rod's own other side.
    far = trimesh.creation.cylinder(radius=0.02, height=0.06, sections=64)
    rod = trimesh.creation.cylinder(radius=0.0005, height=0.06, sections=32)
    rod.apply_translation((0.06, 0.0, 0.0))
    part = a_part(trimesh.util.concatenate([far, rod]))
    model = edge_model(part, EdgeModelConfig(distance=np.inf, inset=0.02))
    on_rod = (model.points[:, 0] > 0.05) & (np.abs(model.points[:, 2]) < 0.0299) & model.visible_in(FRONT)
    assert on_rod.sum() > 10
    assert_allclose(np.linalg.norm(model.points[on_rod, :2] - [0.06, 0.0], axis=1), 0.0005, rtol=0.01)


def test_a_concave_edge_is_occluded_from_behind_and_below() -> None:
    model = edge_model(bracket())
    inner = (np.abs(model.points[:, 0] - 0.006) < 1e-9) & (np.abs(model.points[:, 2] - 0.006) < 1e-9)
    middle = inner & (np.abs(model.points[:, 1] - 0.015) < 0.01)
    assert middle.sum() >= 5
    oblique = [v for v in range(6, 14) if model.views[v][0] > 0 and model.views[v][2] > 0]
    assert len(oblique) == 2
    for view in oblique:
        assert np.all(model.visible_in(view)[middle])
    for view in range(14):
        if model.views[view][0] < 0 or model.views[view][2] < 0:
            assert not np.any(model.visible_in(view)[inner & middle])


def test_a_thin_plate_hides_what_is_on_its_other_side() -> None:
    model = edge_model(boss_on_plate(), EdgeModelConfig(views=26))
    on_boss = (np.abs(model.points[:, 0]) < 0.011) & (np.abs(model.points[:, 1]) < 0.009)
    assert on_boss.sum() > 40
    assert np.any(model.visible_in(UP)[on_boss])
    for view in range(26):
        if model.views[view][2] < -0.1:
            assert not np.any(model.visible_in(view)[on_boss])
    top = model.points[:, 2] > 0.0005
    assert not np.any(model.visible_in(DOWN) & top)
    assert not np.any(model.visible_in(UP) & ~top)


@pytest.mark.parametrize("make", [bracket, boss_on_plate])
def test_edges_are_those_of_an_image(make: Any) -> None:
    part = make()
    model = edge_model(part, EdgeModelConfig(views=26))
    for view in (UP, BACK, CORNER, 9, 15):
        eye = part.centre + 10 * part.d_max * model.views[view]
        drawn = image_edges(part.mesh, eye, part.centre, part.d_max, 100, np.deg2rad(30), 0.02 * part.d_max)
        seen = model.points[model.visible_in(view)]
        # Across the line of sight only: the depth of a pixel that falls on a grazing face is anywhere on that face.
        across = np.linalg.svd(model.views[view][None])[2][1:].T
        assert cKDTree(seen @ across).query(drawn @ across)[0].max() < 0.035 * part.d_max
        assert cKDTree(drawn @ across).query(seen @ across)[0].max() < 0.015 * part.d_max


@pytest.mark.parametrize("make", [cube, bracket, boss_on_plate])
def test_no_visible_point_is_occluded_by_the_part(make: Any) -> None:
    part = make()
    model = edge_model(part)
    for view in (UP, FRONT, CORNER, 11):
        eye = part.centre + 10 * part.d_max * model.views[view]
        assert all(unoccluded(part.mesh, eye, model.points[model.visible_in(view)][::3], 0.001 * part.d_max))


def test_a_step_shows_from_above_when_it_is_a_depth_jump() -> None:
    for share, seen in ((0.01, False), (0.04, True)):
        part = stepped(share * 0.087)
        model = edge_model(part)
        on_step = np.abs(model.points[:, :2]).max(axis=1) < 0.011
        assert np.any(model.visible_in(UP)[on_step]) == seen
        assert np.any(model.visible_in(CORNER)[on_step])


@pytest.mark.parametrize(("right", "seen"), [(0.001, False), (0.006, True)])
def test_a_low_undercut_edge_shows_where_the_surface_turns(right: float, seen: bool) -> None:
    """A rib whose left edge overhangs by 1 mm, half of a depth jump; its top is level or rises to the right."""
    profile = [(-0.001, -0.0005), (0.001, -0.0005), (0.003, right), (-0.003, 0.001)]
    rib = trimesh.convex.convex_hull(np.array([(x, y, z) for x, z in profile for y in (-0.02, 0.02)]))
    plate = trimesh.creation.box(bounds=[(-0.04, -0.03, -0.01), (0.04, 0.03, 0)])
    model = edge_model(a_part(trimesh.boolean.union([plate, rib], engine="manifold")), EdgeModelConfig(distance=np.inf))
    left = (np.abs(model.points[:, 0] + 0.003) < 1e-7) & (np.abs(model.points[:, 1]) < 0.018)
    assert left.sum() > 10
    assert np.all(model.visible_in(UP)[left] == seen)


def test_the_far_side_of_a_depth_jump_is_no_edge() -> None:
    # Seen from right above, a wall with a slanted top hides its own foot.
    profile = [(0, 0), (0.006, 0), (0.006, 0.03), (0, 0.04)]
    wall = trimesh.convex.convex_hull(np.array([(x, y, z) for x, z in profile for y in (0, 0.03)]))
    floor = trimesh.creation.box(bounds=[(0, 0, 0), (0.06, 0.03, 0.006)])
    part = a_part(trimesh.boolean.union([floor, wall], engine="manifold"))
    model = edge_model(part, EdgeModelConfig(distance=np.inf))
    at_wall = np.abs(model.points[:, 0] - 0.006) < 1e-7
    along = np.abs(model.tangents[:, 1]) > 0.9
    foot, top = (at_wall & along & (np.abs(model.points[:, 2] - z) < 1e-7) for z in (0.006, 0.03))
    assert foot.sum() > 5
    assert not np.any(model.visible_in(UP)[foot])
    assert np.sum(model.visible_in(UP)[top]) > 5


def test_the_depth_jump_of_the_config_decides() -> None:
    part = stepped(0.04 * 0.087)
    counts = [
        edge_model(part, EdgeModelConfig(depth_jump=jump)).visible_in(UP).sum() for jump in (0.02, 0.03, 0.06, 0.2)
    ]
    assert counts[0] == counts[1] > counts[2] == counts[3]


def test_the_crease_angle_of_the_config_decides() -> None:
    hexagon = [(0.03 * np.cos(a), 0.03 * np.sin(a)) for a in np.arange(6) * np.pi / 3]
    part = a_part(prism(hexagon, 0.0, 0.04))
    for crease, ridges in ((50, 4), (70, 2)):
        model = edge_model(part, EdgeModelConfig(crease=np.deg2rad(crease), distance=np.inf, inset=0.0))
        upright = model.visible_in(CORNER) & (np.abs(model.tangents[:, 2]) > 0.9)
        assert len(np.unique(model.points[upright, :2].round(6), axis=0)) == ridges


def test_a_near_camera_does_not_see_the_sides_of_a_blunt_pyramid() -> None:
    corners = [(x * w, y * w, z) for w, z in ((0.03, 0.0), (0.025, 0.03)) for x in (-1, 1) for y in (-1, 1)]
    part = a_part(trimesh.convex.convex_hull(np.array(corners)))
    for distance, bottom in ((1.2, False), (np.inf, True)):
        model = edge_model(part, EdgeModelConfig(distance=distance))
        assert np.any(model.points[model.visible_in(UP), 2] < 1e-9) == bottom
