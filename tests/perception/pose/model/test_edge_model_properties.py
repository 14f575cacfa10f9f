"""Edge models: thinning, moved parts, the cache, look-ups by direction, and bad input."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal
from scipy.spatial import cKDTree

from perception.geometry import Floats, rotation_about
from perception.part import PartModel
from perception.pose.model import edge_models
from perception.pose.model.edge_models import EdgeModel, EdgeModelConfig, edge_model, thin
from perception.pose.model.viewpoints import view_directions
from perception.runtime.cache import Arrays
from tests.perception.pose.model.edge_parts import CORNER, DOWN, FRONT, UP, a_part, bracket, cube, gaps, prism


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


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


def test_a_part_ten_times_as_large_has_the_same_edges() -> None:
    part = bracket()
    small, large = edge_model(part), edge_model(moved(part, np.eye(3), np.zeros(3), 10.0))
    for view in range(14):
        seen_small, seen_large = small.visible_in(view), large.visible_in(view)
        assert gaps(10 * small.points[seen_small], large.points[seen_large]) < 0.25 * part.d_max
    assert abs(len(small) - len(large)) < 0.05 * len(small)


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
