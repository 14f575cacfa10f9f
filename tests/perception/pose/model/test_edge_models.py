"""Edge models: solids whose visible edges are counted by hand, and an image drawn ray by ray."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree

from perception.geometry import Floats, rotation_about
from perception.part import PartModel
from perception.pose.model import edge_models
from perception.pose.model.edge_models import EdgeModel, EdgeModelConfig, edge_model, thin
from perception.pose.model.viewpoints import view_directions
from perception.runtime.cache import Arrays
from tests.reference.edge_models_twin import image_edges, unhidden

UP, DOWN, FRONT, BACK, CORNER = 0, 1, 2, 3, 6
VIEWS_OF_X = {UP: (0, 0, 1), DOWN: (0, 0, -1), FRONT: (1, 0, 0), BACK: (-1, 0, 0), CORNER: (1, 1, 1)}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def a_part(mesh: trimesh.Trimesh) -> PartModel:
    return PartModel.from_mesh("test", mesh)


def prism(outline: list[tuple[float, float]], low: float, high: float) -> trimesh.Trimesh:
    """A convex outline, anticlockwise, extruded along z."""
    return trimesh.convex.convex_hull(np.array([(x, y, z) for x, y in outline for z in (low, high)]))


def cube() -> PartModel:
    return a_part(trimesh.creation.box(extents=(0.04, 0.04, 0.04)))


def bracket() -> PartModel:
    """An L: a floor of 60 x 30 x 6 mm and a wall of 6 x 30 x 40 mm at its -x end."""
    floor = trimesh.creation.box(bounds=[(0, 0, 0), (0.06, 0.03, 0.006)])
    wall = trimesh.creation.box(bounds=[(0, 0, 0), (0.006, 0.03, 0.04)])
    return a_part(trimesh.boolean.union([floor, wall], engine="manifold"))


def stepped(height: float) -> PartModel:
    """A block of 60 x 60 x 20 mm with a smaller one of ``height`` on it."""
    block = trimesh.creation.box(bounds=[(-0.03, -0.03, 0), (0.03, 0.03, 0.02)])
    step = trimesh.creation.box(bounds=[(-0.01, -0.01, 0.01), (0.01, 0.01, 0.02 + height)])
    return a_part(trimesh.boolean.union([block, step], engine="manifold"))


def boss_on_plate() -> PartModel:
    plate = trimesh.creation.box(bounds=[(-0.04, -0.03, 0), (0.04, 0.03, 0.001)])
    boss = trimesh.creation.box(bounds=[(-0.01, -0.008, 0), (0.01, 0.008, 0.011)])
    return a_part(trimesh.boolean.union([plate, boss], engine="manifold"))


def edges_seen(model: EdgeModel, view: int) -> int:
    """How many of a box's edges (lines of the bounding box) have points in a view."""
    points, tangents = model.points[model.visible_in(view)], model.tangents[model.visible_in(view)]
    low, high = model.centre - 0.02, model.centre + 0.02
    along = np.argmax(np.abs(tangents), axis=1)
    lines = {
        (int(axis), *(np.delete(point, axis) > np.delete((low + high) / 2, axis)).tolist())
        for axis, point in zip(along, points, strict=True)
    }
    return len(lines)


def gaps(points_a: Floats, points_b: Floats) -> float:
    """The largest distance from a point of one set to the other set, both ways."""
    return float(max(cKDTree(points_b).query(points_a)[0].max(), cKDTree(points_a).query(points_b)[0].max()))


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
    hidden = rim & (model.points[:, 2] < 0) & (model.points[:, :2].sum(axis=1) < -0.01)
    assert hidden.sum() > 10
    assert not np.any(model.visible_in(CORNER)[hidden])


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


def test_a_concave_edge_is_hidden_from_behind_and_below() -> None:
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
def test_no_visible_point_is_hidden_by_the_part(make: Any) -> None:
    part = make()
    model = edge_model(part)
    for view in (UP, FRONT, CORNER, 11):
        eye = part.centre + 10 * part.d_max * model.views[view]
        assert all(unhidden(part.mesh, eye, model.points[model.visible_in(view)][::3], 0.001 * part.d_max))


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


def test_a_wider_thinning_keeps_fewer_points() -> None:
    fine, coarse = (len(edge_model(cube(), EdgeModelConfig(thinning=t))) for t in (0.02, 0.06))
    assert 2.3 < fine / coarse < 4


def test_parallel_creases_closer_than_the_thinning_are_one_line() -> None:
    a, c = 0.03, 0.0007  # a chamfer of 1 mm at d_max 94 mm: its two creases of 45 degrees are 0.011 d_max apart
    chamfered = [(a, -a), (a, a - c), (a - c, a), (-a, a), (-a, -a)]
    model = edge_model(a_part(prism(chamfered, -0.02, 0.02)))
    upright = np.abs(model.tangents[:, 2]) > 0.9
    at_chamfer = upright & (model.points[:, 0] > 0) & (model.points[:, 1] > 0)
    at_corner = upright & (model.points[:, 0] < 0) & (model.points[:, 1] < 0)
    assert at_corner.sum() >= 12
    for view in (FRONT, CORNER, 4):
        seen = at_chamfer & model.visible_in(view)
        assert abs(int(seen.sum()) - int(at_corner.sum())) <= 1


def test_thinning_leaves_each_view_the_points_that_no_earlier_point_stands_for() -> None:
    points = np.array([(0, 0, 0), (0.5, 0, 0), (0.6, 0, 0), (3, 0, 0), (3.1, 0, 0)], dtype=np.float64)
    tangents = np.array([(1, 0, 0), (-1, 0, 0), (1, 0, 0), (1, 0, 0), (0.6, 0.8, 0)], dtype=np.float64)
    masks = np.array([0b1, 0b11, 0b101, 0b1, 0b1], dtype=np.uint32)
    before = masks.copy()
    assert_array_equal(thin(points, tangents, masks, 1.0, 0.5), [0, 0b11, 0b100, 1, 1])
    assert_array_equal(thin(points, tangents, masks, 1.0, 1.0), [0, 0b11, 0b100, 1, 0])
    assert_array_equal(thin(points, tangents, masks, 0.05, 0.5), masks)
    assert_array_equal(masks, before)
    assert thin(points[:0], tangents[:0], masks[:0], 1.0, 0.5).shape == (0,)


def test_within_a_view_no_two_parallel_points_are_closer_than_the_thinning() -> None:
    model = edge_model(bracket())
    for view in range(14):
        points, tangents = model.points[model.visible_in(view)], model.tangents[model.visible_in(view)]
        pairs = cKDTree(points).query_pairs(0.0249 * model.d_max, output_type="ndarray")
        assert len(pairs) > 0  # at corners
        assert np.abs(np.einsum("ci,ci->c", tangents[pairs[:, 0]], tangents[pairs[:, 1]])).max() < np.cos(np.pi / 6)


def moved(part: PartModel, rotation: Floats, shift: Floats, scale: float = 1.0) -> PartModel:
    mesh = part.mesh.copy()
    mesh.vertices = scale * mesh.vertices @ rotation.T + shift
    return a_part(mesh)


def test_a_shifted_part_has_shifted_edges() -> None:
    part, shift = bracket(), np.array([0.3, -0.2, 0.1])
    here, there = edge_model(part), edge_model(moved(part, np.eye(3), shift))
    for view in range(14):
        apart = gaps(here.points[here.visible_in(view)] + shift, there.points[there.visible_in(view)])
        assert apart < 0.025 * part.d_max


def test_a_turned_part_has_turned_edges_in_the_turned_view() -> None:
    part, rotation = bracket(), rotation_about((1, 1, 1), 2 * np.pi / 3)
    here, there = edge_model(part), edge_model(moved(part, rotation, np.zeros(3)))
    for view in range(14):
        turned = int(there.nearest_view(rotation @ here.views[view]))
        seen_here, seen_there = here.visible_in(view), there.visible_in(turned)
        assert gaps(here.points[seen_here] @ rotation.T, there.points[seen_there]) < 0.025 * part.d_max


def test_a_part_in_millimetres_has_the_same_edges() -> None:
    part = bracket()
    metres, millimetres = edge_model(part), edge_model(moved(part, np.eye(3), np.zeros(3), 1000.0))
    for view in range(14):
        seen, seen_mm = metres.visible_in(view), millimetres.visible_in(view)
        assert gaps(1000 * metres.points[seen], millimetres.points[seen_mm]) < 25 * part.d_max
    assert abs(len(metres) - len(millimetres)) < 0.05 * len(metres)


def test_the_cache_answers_with_the_same_bits(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = edge_model(bracket())
    with monkeypatch.context() as patch:
        patch.setattr(edge_models, "_compute", refuse)
        again = edge_model(bracket())
        for other in (EdgeModelConfig(views=6), EdgeModelConfig(crease=1.0), EdgeModelConfig(thinning=0.1)):
            with pytest.raises(RuntimeError, match="computed"):
                edge_model(bracket(), other)
        with pytest.raises(RuntimeError, match="computed"):
            edge_model(cube())
    assert [path.name.startswith("edges-") for path in folder.iterdir()] == [True]
    monkeypatch.setenv("BINPICK_CACHE", str(folder / "other"))
    anew = edge_model(bracket())
    for model in (again, anew):
        for name in ("points", "tangents", "visibility", "views", "centre"):
            assert_array_equal(getattr(model, name), getattr(first, name))
            assert getattr(model, name).dtype == getattr(first, name).dtype


def refuse(part: PartModel, config: EdgeModelConfig) -> Arrays:
    raise RuntimeError("computed, although it should be stored")


def test_the_nearest_view_takes_any_shape_and_length() -> None:
    model = edge_model(cube())
    assert model.nearest_view((0, 0.1, 5.0)) == UP
    assert model.nearest_view((0, 0.1, 5.0)).shape == ()
    assert_array_equal(model.nearest_view(7 * model.views), np.arange(14))
    assert model.nearest_view(np.ones((2, 3, 3))).tolist() == [[CORNER] * 3] * 2
    assert model.nearest_view((0, 0, 1)).dtype == np.int64
    assert edge_model(cube(), EdgeModelConfig(views=6)).nearest_view((1, 0, 1)) == UP


def test_what_is_visible_from_a_direction_is_the_nearest_views() -> None:
    model = edge_model(cube())
    assert_array_equal(model.visible_from((0.1, 0.2, -3.0)), model.visible_in(DOWN))
    assert_array_equal(model.visible_from((1, 1, 0.9)), model.visible_in(CORNER))
    assert len(model) == len(model.points)
    with pytest.raises(ValueError, match=r"direction_part must be \(3,\), got \(1, 3\)"):
        model.visible_from([(0, 0, 1)])


@pytest.mark.parametrize(
    ("direction", "text"),
    [
        ((0, 0, 0), "direction_part must be finite and not zero"),
        ((0, np.nan, 1), "direction_part must be finite and not zero"),
        ((1, 0), r"direction_part must be \(..., 3\), got \(2,\)"),
        (1.0, r"direction_part must be \(..., 3\), got \(\)"),
    ],
)
def test_a_direction_must_be_one(direction: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        edge_model(cube()).nearest_view(direction)


@pytest.mark.parametrize("view", [-1, 14])
def test_a_view_must_exist(view: int) -> None:
    with pytest.raises(ValueError, match=f"view must be in 0 to 13, got {view}"):
        edge_model(cube()).visible_in(view)


def inside_out() -> trimesh.Trimesh:
    mesh = trimesh.creation.box()
    mesh.invert()
    return mesh


def opened() -> trimesh.Trimesh:
    mesh = trimesh.creation.box()
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:-1], process=False)


@pytest.mark.parametrize("mesh", [trimesh.Trimesh(), opened(), inside_out()], ids=["empty", "open", "inside out"])
def test_a_mesh_must_enclose_a_volume(mesh: trimesh.Trimesh) -> None:
    part = replace(cube(), name="bad", mesh=mesh)
    with pytest.raises(ValueError, match="mesh of 'bad' must enclose a volume"):
        edge_model(part)


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("views", 8, r"views must be one of \[1, 6, 14, 26\], got 8"),
        ("distance", 1.0, "distance must be more than 1 d_max .*, got 1.0"),
        ("distance", np.nan, "distance must be more than 1 d_max .*, got nan"),
        ("crease", 0.0, r"crease must be in \(0, pi/2\] rad, got 0.0"),
        ("crease", 30.0, r"crease must be in \(0, pi/2\] rad, got 30.0"),
        ("thinning_angle", -1.0, r"thinning_angle must be in \(0, pi/2\] rad, got -1.0"),
        ("depth_jump", 0.0, "depth_jump must be between 0 and 1 d_max, got 0.0"),
        ("depth_jump", 1.0, "depth_jump must be between 0 and 1 d_max, got 1.0"),
        ("inset", -0.01, "inset must be at least 0 and under 0.1 d_max, got -0.01"),
        ("inset", 0.1, "inset must be at least 0 and under 0.1 d_max, got 0.1"),
        ("thinning", 0.0, "thinning must be at least 0.001 and under 1 d_max, got 0.0"),
        ("thinning", 2.0, "thinning must be at least 0.001 and under 1 d_max, got 2.0"),
    ],
)
def test_nonsense_settings_are_refused(field: str, value: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        EdgeModelConfig(**{field: value})


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("points", np.zeros((2, 2)), r"points must be \(N, 3\)"),
        ("tangents", np.zeros((1, 3)), "tangents must be"),
        ("visibility", np.zeros(3, np.uint32), "visibility must be"),
        ("visibility", np.zeros(2, np.int64), "visibility must be uint32, got int64"),
        ("views", np.zeros((14, 2)), "views must be"),
        ("views", np.zeros((33, 3)), "views must be 1 to 32, a bit each, got 33"),
        ("views", np.zeros((0, 3)), "views must be 1 to 32, a bit each, got 0"),
        ("centre", np.zeros(2), "centre must be"),
        ("d_max", 0.0, "d_max must be positive, got 0.0"),
        ("d_max", np.inf, "d_max must be positive, got inf"),
    ],
)
def test_a_model_refuses_arrays_that_do_not_fit(field: str, value: Any, text: str) -> None:
    model = EdgeModel(
        points=np.zeros((2, 3)),
        tangents=np.eye(3)[:2],
        visibility=np.ones(2, np.uint32),
        views=view_directions(14),
        centre=np.zeros(3),
        d_max=1.0,
    )
    with pytest.raises(ValueError, match=text):
        replace(model, **{field: value})
