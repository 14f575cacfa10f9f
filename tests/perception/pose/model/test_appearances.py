"""Edges of blocks from all round, and how many pixels they make."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from perception.part import PartModel
from perception.pose.model import appearances as module
from perception.pose.model._pair_kernels import tangent_frames
from perception.pose.model.appearances import EdgeAppearances, edge_appearances
from perception.pose.model.edge_models import EdgeModelConfig, edges_by_view
from perception.pose.model.thinning import thin_points
from tests.perception.pose import observed_part as at

ELL = at.ell()
SIDES = (0.06, 0.04, 0.03)
BOX = PartModel.from_mesh("box", trimesh.creation.box(SIDES))
CONFIG = EdgeModelConfig()


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def ell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EdgeAppearances]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BINPICK_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield edge_appearances(ELL, subdivisions=1)


def test_views_are_unit_and_lie_all_round(ell: EdgeAppearances) -> None:
    np.testing.assert_allclose(np.linalg.norm(ell.views, axis=1), 1.0, atol=1e-12)
    assert len(ell.views) == 42
    np.testing.assert_allclose(ell.views.sum(axis=0), 0.0, atol=1e-12)
    away = np.degrees(np.arccos(np.clip(ell.views @ ell.views.T, -1, 1))) + 360 * np.eye(42)
    assert 30 < away.min() <= away.min(axis=1).max() < 40


def test_every_view_has_the_thinned_edges_of_its_direction(ell: EdgeAppearances) -> None:
    radius = CONFIG.thinning * ELL.d_max
    for view, (_, points, tangents) in enumerate(edges_by_view(ELL, ell.views, CONFIG)):
        kept = thin_points(points, tangents, radius, CONFIG.thinning_angle)
        assert 30 < len(kept) < 0.5 * len(points)
        found = ell.seen_from(ell.views[view])
        np.testing.assert_array_equal(found[0], points[kept])
        np.testing.assert_array_equal(found[1], tangents[kept])


def test_the_nearest_view_is_taken(ell: EdgeAppearances) -> None:
    rng = np.random.default_rng(0)
    for direction in rng.normal(size=(20, 3)):
        nearest = int(np.argmin([np.linalg.norm(view - direction / np.linalg.norm(direction)) for view in ell.views]))
        points, tangents = ell.seen_from(direction)
        np.testing.assert_array_equal(points, ell.points[ell.starts[nearest] : ell.starts[nearest + 1]])
        np.testing.assert_array_equal(tangents, ell.tangents[ell.starts[nearest] : ell.starts[nearest + 1]])


@pytest.mark.parametrize("step", [1, 2, 3, 1000])
def test_every_so_many_points_of_each_view_are_taken(ell: EdgeAppearances, step: int) -> None:
    fewer = ell.every(step)
    assert fewer.starts.dtype == np.int64
    for view in ell.views:
        points, tangents = ell.seen_from(view)
        found = fewer.seen_from(view)
        np.testing.assert_array_equal(found[0], [points[k] for k in range(0, len(points), step)])
        np.testing.assert_array_equal(found[1], [tangents[k] for k in range(0, len(points), step)])
    np.testing.assert_array_equal(fewer.views, ell.views)
    assert fewer.expected_points(at.K, 0.5) == ell.expected_points(at.K, 0.5)


def test_every_so_many_points_of_views_without_any_are_none() -> None:
    """The second view has no points, the third has one."""
    points = np.arange(12.0).reshape(4, 3)
    few = EdgeAppearances(
        views=np.eye(3),
        starts=np.array([0, 3, 3, 4]),
        lengths=np.ones(3),
        points=points,
        tangents=-points,
        centre=np.zeros(3),
        d_max=1.0,
    )
    half = few.every(2)
    assert half.starts.tolist() == [0, 2, 2, 3]
    assert half.points.tolist() == points[[0, 2, 3]].tolist()
    assert half.tangents.tolist() == (-points[[0, 2, 3]]).tolist()
    nothing = replace(few, starts=np.zeros(4, np.int64), points=points[:0], tangents=points[:0]).every(2)
    assert (nothing.starts.tolist(), nothing.points.shape) == ([0, 0, 0, 0], (0, 3))


@pytest.mark.parametrize("step", [0, -2])
def test_a_step_that_leads_nowhere_is_refused(ell: EdgeAppearances, step: int) -> None:
    with pytest.raises(ValueError, match=f"step must be at least 1, got {step}"):
        ell.every(step)


def test_a_box_is_seen_from_above_without_what_lies_below() -> None:
    box = edge_appearances(BOX, subdivisions=1)
    points, tangents = box.seen_from(np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(points[:, 2], SIDES[2] / 2, atol=1e-9)
    assert (np.abs(tangents[:, :2]).max(axis=1) > 1 - 1e-9).all()
    np.testing.assert_allclose(np.abs(points).max(axis=0), np.array(SIDES) / 2, atol=0.0011)
    assert (box.centre.tolist(), box.d_max) == (BOX.centre.tolist(), BOX.d_max)


def test_the_length_of_a_box_seen_face_on_is_its_perimeter() -> None:
    box = edge_appearances(BOX, subdivisions=1)
    for axis in range(3):
        a, b = np.delete(SIDES, axis)
        for sign in (1.0, -1.0):
            view = int(np.argmax(box.views[:, axis] * sign))
            assert box.views[view, axis] * sign == pytest.approx(1.0)
            assert box.lengths[view] == pytest.approx(2 * (a + b), rel=0.03)


def test_expected_points_are_the_pixels_of_the_longest_outline() -> None:
    perimeter = 2 * (0.06 + 0.04) * 1200 / 0.5  # [px] of the box's largest face, half a metre away
    box = edge_appearances(BOX, subdivisions=1)
    face_on = np.where(np.abs(box.views[:, 2]) > 0.999, box.lengths, 0.0)
    assert replace(box, lengths=face_on).expected_points(at.K, 0.5) == pytest.approx(perimeter, rel=0.03)
    assert replace(box, lengths=face_on).expected_points(2 * at.K, 0.5) == pytest.approx(2 * perimeter, rel=0.03)
    sheet = PartModel.from_mesh("sheet", trimesh.creation.box((0.06, 0.04, 0.0004)))  # longest seen face-on, or nearly
    # Seen aslant, the edges of its two faces fall into two rows of pixels here and there.
    assert 0.97 * perimeter < edge_appearances(sheet, subdivisions=1).expected_points(at.K, 0.5) < 1.3 * perimeter
    assert box.expected_points(at.K, 0.5) > 1.1 * perimeter  # over a corner it shows nine edges


def test_expected_points_are_those_of_the_horizontal_focal_length(ell: EdgeAppearances) -> None:
    K = np.array([[1200.0, 0.0, 90.0], [0.0, 900.0, 140.0], [0.0, 0.0, 1.0]])
    assert ell.expected_points(K, 0.5) == round(ell.lengths.max() * 1200.0 / 0.5)
    assert ell.expected_points(K[:, [1, 0, 2]][[1, 0, 2]], 0.5) == round(ell.lengths.max() * 900.0 / 0.5)


def test_expected_points_fall_with_the_distance(ell: EdgeAppearances) -> None:
    near, far = ell.expected_points(at.K, 0.25), ell.expected_points(at.K, 1.0)
    assert near == pytest.approx(4 * far, abs=2)
    assert near == round(ell.lengths.max() * 4800)
    for depth in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=f"depth must be positive, got {depth}"):
            ell.expected_points(at.K, depth)


def test_creases_count_where_they_are_seen(ell: EdgeAppearances) -> None:
    """A box seen onto a corner shows nine edges."""
    box = edge_appearances(BOX, subdivisions=2)
    view = int(np.argmax(box.views @ np.ones(3)))
    across = np.eye(3) - np.outer(box.views[view], box.views[view])
    plane = tangent_frames(box.views[view][None])[0, 1:] @ across
    # A line has a pixel in each column, or in each row if it is steep.
    drawn = 3 * sum(side * np.abs(plane[:, k]).max() for k, side in enumerate(SIDES))
    assert box.lengths[view] == pytest.approx(drawn, rel=0.05)


def test_they_are_read_from_the_cache(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = edge_appearances(ELL, subdivisions=1)
    assert [path.name.split("-")[0] for path in folder.iterdir()] == ["appearances"]

    def refuse(*arguments: object) -> None:
        raise RuntimeError("computed")

    monkeypatch.setattr(module, "_compute", refuse)
    again = edge_appearances(at.ell(), subdivisions=1)
    for name in ("views", "starts", "lengths", "points", "tangents", "centre"):
        have, want = getattr(again, name), getattr(first, name)
        assert (have.dtype, have.tobytes()) == (want.dtype, want.tobytes()), name
    for part, config, subdivisions in ((BOX, None, 1), (ELL, EdgeModelConfig(thinning=0.05), 1), (ELL, None, 2)):
        with pytest.raises(RuntimeError, match="computed"):
            edge_appearances(part, config, subdivisions)


def test_they_are_the_same_every_time(ell: EdgeAppearances) -> None:
    again = edge_appearances(at.ell(), subdivisions=1)  # in a cache of its own
    assert again.points.tobytes() == ell.points.tobytes()


def test_the_settings_count(ell: EdgeAppearances) -> None:
    coarse = edge_appearances(ELL, EdgeModelConfig(thinning=0.05), subdivisions=1)
    assert len(coarse.points) < 0.7 * len(ell.points)
    assert len(edge_appearances(ELL, EdgeModelConfig(crease=np.pi / 2), subdivisions=1).points) < 0.9 * len(ell.points)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": np.zeros((2, 2))}, r"views must be \(N, 3\), got \(2, 2\)"),
        ({"starts": np.array([0, 1])}, r"starts must be \(43,\), got \(2,\)"),
        ({"lengths": np.zeros(3)}, r"lengths must be \(42,\), got \(3,\)"),
        ({"points": np.zeros((3, 2))}, r"points must be \(N, 3\), got \(3, 2\)"),
        ({"tangents": np.zeros((1, 3))}, r"tangents must be \(\d+, 3\), got \(1, 3\)"),
        ({"starts": np.zeros(43, np.int64)}, r"starts must run from 0 to \d+ over at least one view"),
        ({"starts": np.arange(1, 44)}, r"starts must run from 0 to \d+ over at least one view"),
        (
            {"views": np.zeros((0, 3)), "lengths": np.zeros(0), "starts": np.array([0]), "points": np.zeros((0, 3)),
             "tangents": np.zeros((0, 3))},
            "starts must run from 0 to 0 over at least one view",
        ),
    ],
)  # fmt: skip
def test_arrays_that_do_not_fit_are_refused(ell: EdgeAppearances, change: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(ell, **change)  # type: ignore[arg-type]


def test_a_part_turned_inside_out_is_refused() -> None:
    mesh = ELL.mesh.copy()
    mesh.invert()
    with pytest.raises(ValueError, match="the mesh of 'ell' must enclose a volume"):
        edge_appearances(replace(ELL, mesh=mesh), subdivisions=1)
