"""Room that two bodies share and what reaches out of a bin: cubes by hand, other parts against a plain twin."""

import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numba import njit

from perception.frame import Workspace
from perception.geometry import Floats, invert_transform, make_transform, random_rotation, rotation_about
from perception.part import PartModel, Symmetry, diameter
from perception.pose.model.surface_models import surface_model
from perception.pose.selection import bodies as module
from perception.pose.selection._body_kernels import samples_shared, samples_within
from perception.pose.selection.bodies import BodyConfig, BodyModel, body_model
from tests.perception.pose import observed_part as at
from tests.perception.pose import posed_parts as pp
from tests.reference import bodies_twin as twin

CUBE = PartModel(  # of side 1, about the origin
    name="cube",
    mesh=trimesh.creation.box((1.0, 1.0, 1.0)),
    d_max=float(np.sqrt(3)),
    symmetry=Symmetry(),
    centre=np.zeros(3),
)
ELL = at.ell()
HERE = make_transform()
BIN = Workspace(T_world_bin=np.eye(4), inner_size=np.array([6.0, 4.0, 3.0]))
DIAGONAL = np.sqrt(0.75)  # from a cube's centre to its corner


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module", autouse=True)
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let the bodies that several tests use go into a cache of their own, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BINPICK_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def body(part: PartModel) -> BodyModel:
    return body_model(part, surface_model(part))


@pytest.fixture(scope="module")
def cube(shared_folder: None) -> BodyModel:
    """A cube with 1600 samples in even rows on each face."""
    row = (np.arange(40) + 0.5) / 40 - 0.5
    face = np.stack(np.meshgrid(row, row, [0.5], indexing="ij"), axis=-1).reshape(-1, 3)
    faces = [sign * np.roll(face, axis, axis=1) for axis in range(3) for sign in (1.0, -1.0)]
    return replace(body(CUBE), samples=np.concatenate(faces))


@pytest.fixture(scope="module")
def ell(shared_folder: None) -> BodyModel:
    return body(ELL)


def moved(x: float = 0.0, y: float = 0.0, z: float = 0.0, rotation: Floats | None = None) -> Floats:
    return make_transform(rotation, (x, y, z))


# Overlap


@pytest.mark.parametrize("slab", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("depth", [0.03, 0.06])
@pytest.mark.parametrize("axis", range(3))
def test_cubes_share_the_slab_that_one_is_pushed_into_the_other(
    cube: BodyModel, slab: float, depth: float, axis: int
) -> None:
    """Deep in the other cube lies all of one face but a rim; the sides lie in the surface of the other."""
    for sign in (1.0, -1.0):
        T = make_transform(translation=sign * (1 - slab) * np.eye(3)[axis])
        assert cube.overlap(HERE, T, depth) == pytest.approx((1 - 2 * depth) ** 2 / 6, abs=0.01)


def test_cubes_pushed_less_far_than_the_depth_share_nothing(cube: BodyModel) -> None:
    for slab in (-0.3, 0.0, 0.02):
        assert cube.overlap(HERE, moved(x=1 - slab), 0.05) == 0.0
    assert cube.overlap(HERE, moved(x=0.92), 0.05) > 0.1


def test_a_cubes_corner_in_another_cube(cube: BodyModel) -> None:
    """Three squares of side 0.4, less a rim as deep as is asked for where they enter, and not along their edges."""
    T = moved(0.6, 0.6, 0.6)
    for depth in (0.04, 0.1):
        assert cube.overlap(HERE, T, depth) == pytest.approx(3 * (0.4 - depth) ** 2 / 6, abs=0.012)


@pytest.mark.parametrize("seed", range(4))
def test_the_overlap_is_the_same_in_every_frame_and_order(ell: BodyModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = at.random_pose(ELL, rng)
    other = at.beside(T, ELL, rng, 0.015, 1.0)
    motion = make_transform(random_rotation(rng), rng.normal(size=3))
    depth = 0.01 * ELL.d_max
    found = ell.overlap(T, other, depth)
    assert 0.02 < found < 0.5
    one = 1.01 / (2 * len(ell.samples))  # a sample as deep as is asked for may count or not
    assert ell.overlap(other, T, depth) == pytest.approx(found, abs=one)
    assert ell.overlap(motion @ T, motion @ other, depth) == pytest.approx(found, abs=one)


@pytest.mark.slow
@pytest.mark.parametrize("part", [ELL, pp.wheel(), pp.wedge()], ids=lambda part: part.name)
def test_the_overlap_is_that_of_the_distances_to_the_surface(part: PartModel) -> None:
    """The grid may be wrong by a cell; the parts' own origins lie outside of them or in a corner."""
    mine, rng = body(part), np.random.default_rng(31)
    shares = []
    for distance in (0.0, 0.2, 0.4, 0.6, 0.8, 1.2):
        T = pp.random_pose(rng)
        other = make_transform(None, distance * part.d_max * rng.normal(size=3) / np.sqrt(3)) @ T
        other = other @ pp.about_centre(part, random_rotation(rng))
        deep = []
        for T_a, T_b in ((T, other), (other, T)):
            T_a_b = invert_transform(T_a) @ T_b
            deep.append(twin.depths(part.mesh, mine.samples @ T_a_b[:3, :3].T + T_a_b[:3, 3]))
        share, depth = mine.overlap(T, other, 0.02 * part.d_max), 0.02 * part.d_max
        assert np.mean(np.concatenate(deep) > depth + mine.cell) <= share, distance
        assert share <= np.mean(np.concatenate(deep) > depth - mine.cell), distance
        shares.append(share)
    assert max(shares) > 0.1
    assert min(shares) == 0.0


def test_nothing_lies_in_the_bore_of_a_pipe() -> None:
    """Two short pipes at right angles, each through the other's bore: nothing is shared where there is room."""
    ring = PartModel.from_mesh("ring", trimesh.creation.annulus(0.03, 0.04, 0.01, sections=24))
    mine, depth = body(ring), 0.01 * ring.d_max
    linked = moved(x=0.035, rotation=rotation_about((1.0, 0.0, 0.0), np.pi / 2))  # like links of a chain
    assert mine.overlap(HERE, linked, depth) == 0.0
    assert mine.overlap(HERE, moved(x=0.003, rotation=linked[:3, :3]), depth) > 0.02


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (5.0, -2.0, 3.0)])
def test_long_bodies_touch_far_from_their_middles(origin: tuple[float, float, float]) -> None:
    """Where two rods' ends meet their middles are nearly as far apart as they can be."""
    mesh = trimesh.creation.box((1.0, 0.1, 0.1)).apply_translation(origin)
    rod = PartModel(name="rod", mesh=mesh, d_max=diameter(mesh.vertices), symmetry=Symmetry(), centre=mesh.center_mass)
    mine = body(rod)
    turn = make_transform(rotation_about((0.0, 1.0, 0.0), 1.0), (0.2, 0.1, 0.7))
    for gap, shared in ((-0.05, True), (0.02, False), (3.0, False)):
        ahead = make_transform(translation=(1.0 + gap, 0.01, 0.01))
        assert (mine.overlap(turn, turn @ ahead, 0.015) > 0) == shared


def test_a_body_is_as_large_as_its_part(ell: BodyModel) -> None:
    assert ell.samples.shape == (512, 3)
    assert len(np.unique(ell.samples, axis=0)) == 512
    surface = surface_model(ELL).points
    assert (np.abs(ell.samples[:, None] - surface).sum(axis=-1).min(axis=1) == 0).all()
    np.testing.assert_allclose(ell.samples.max(axis=0), ELL.mesh.bounds[1], atol=0.003)
    np.testing.assert_allclose(ell.middle, ELL.mesh.bounds.mean(axis=0))
    assert ell.radius == pytest.approx(np.linalg.norm(np.ptp(ELL.mesh.bounds, axis=0)) / 2)
    assert len(ell.corners) == 10  # of the twelve, two are in the notch
    few = body_model(ELL, surface_model(ELL, 0.2))
    assert len(few.samples) == len(surface_model(ELL, 0.2).points) < 512


@pytest.mark.parametrize("part", [CUBE, ELL, pp.wheel(), pp.rod()], ids=lambda part: part.name)
def test_the_grid_has_the_depth_below_the_surface(part: PartModel) -> None:
    mine, rng = body(part), np.random.default_rng(0)
    places = rng.integers(0, mine.inside.shape, (400, 3))
    error = mine.inside[tuple(places.T)] - twin.depths(part.mesh, mine.origin + mine.cell * places)
    assert error.min() / mine.cell > -1.5
    assert error.max() / mine.cell < 0.6
    assert abs(np.median(error)) / mine.cell < 0.5
    assert mine.inside.max() > 0
    rim = np.ones(mine.inside.shape, bool)
    rim[1:-1, 1:-1, 1:-1] = False
    assert (mine.inside[rim] < -mine.cell).all()  # so what is outside of the grid is outside of the part


# The kernel


@pytest.mark.parametrize("seed", range(3))
def test_samples_within_are_those_of_the_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inside = rng.normal(size=(4, 5, 6)).astype(np.float32)
    T = make_transform(random_rotation(rng), rng.normal(size=3))
    origin, cell = rng.normal(size=3), 0.3
    places = origin + cell * rng.uniform(-1, 7, (400, 3))
    samples = (places - T[:3, 3]) @ T[:3, :3]
    samples[::50, 1] = np.nan
    for depth in (-0.5, 0.0, 0.4):
        arguments = T, samples, inside, origin, cell, depth
        assert samples_within(*arguments) == twin.samples_within(*arguments) > 3
    assert samples_within(T, samples[:0], inside, origin, cell, 0.0) == 0


@pytest.mark.parametrize("seed", range(3))
def test_shared_samples_are_counted_both_ways_and_not_where_the_parts_are_far_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inside = rng.normal(size=(4, 5, 6)).astype(np.float32)
    middle, radius, cell = np.array([0.4, 0.5, 0.6]), 0.9, 0.3
    samples = cell * rng.uniform(0, 5, (300, 3))
    turns = random_rotation(rng), random_rotation(rng)
    ahead = np.array([0.0, 0.0, 2.0])
    T_a, T_b = (make_transform(turn, ahead + rng.uniform(-0.1, 0.1, 3) - turn @ middle) for turn in turns)
    grid = samples, inside, np.zeros(3), cell, 0.2
    want = samples_within(invert_transform(T_a) @ T_b, *grid) + samples_within(invert_transform(T_b) @ T_a, *grid)
    assert samples_shared(T_a, T_b, middle, radius, *grid) == want > 20
    away = float(np.linalg.norm((T_a[:3, :3] - T_b[:3, :3]) @ middle + T_a[:3, 3] - T_b[:3, 3]))
    assert samples_shared(T_a, T_b, middle, away / 2 - 1e-6, *grid) == 0
    assert samples_shared(T_a, T_b, middle, away / 2 + 1e-6, *grid) == want


def test_no_sample_is_looked_up_beyond_the_grid() -> None:
    checked = njit(boundscheck=True)(samples_within.py_func)
    inside, rng = np.ones((3, 4, 2), np.float32), np.random.default_rng(0)
    edges = np.stack(np.meshgrid(*[(-1.0, -1e-9, 0.0, 0.5, n - 1 - 1e-9, n - 1, n) for n in inside.shape]), axis=-1)
    samples = np.concatenate([edges.reshape(-1, 3), rng.uniform(-2, 6, (500, 3)), [[1e300, 0, 0], [0, -np.inf, 0]]])
    want = np.count_nonzero(((samples >= 0) & (samples < np.array(inside.shape) - 1)).all(axis=1))
    assert want > 27
    for kernel in (checked, samples_within):
        assert kernel(HERE, samples, inside, np.zeros(3), 1.0, 0.5) == want


def test_between_grid_points_the_depth_is_between_theirs() -> None:
    inside = np.zeros((2, 2, 2), np.float32)
    inside[1, 1, 0], inside[1, 1, 1] = 1.0, 3.0
    place = np.array([[0.5, 0.25, 0.75]])  # 0.5 * 0.25 * (0.25 * 1 + 0.75 * 3) = 0.3125
    for depth, count in ((0.3124, 1), (0.3126, 0)):
        assert samples_within(HERE, place, inside, np.zeros(3), 1.0, depth) == count
        assert samples_within(HERE, 2 * place - 1, inside, -np.ones(3), 2.0, depth) == count


# Out of the bin


def test_a_cube_reaches_through_the_floor_by_what_is_below_it(cube: BodyModel) -> None:
    assert cube.protrusion(moved(z=0.5), BIN) == 0.0
    assert cube.protrusion(moved(z=0.3), BIN) == pytest.approx(0.2)
    leaning = rotation_about((1.0, -1.0, 0.0), np.arctan(np.sqrt(2)))  # onto a corner
    assert cube.protrusion(moved(z=0.8, rotation=leaning), BIN) == pytest.approx(DIAGONAL - 0.8)
    assert cube.protrusion(moved(z=0.9, rotation=leaning), BIN) == 0.0


def test_floor_and_walls_are_told_apart(cube: BodyModel) -> None:
    assert cube.protrusions(moved(x=2.8, z=0.4), BIN) == pytest.approx((0.1, 0.3))
    assert cube.protrusions(moved(x=2.0, z=0.7), BIN) == pytest.approx((-0.2, -0.5))


@pytest.mark.parametrize(("axis", "half"), [(0, 3.0), (1, 2.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_cube_reaches_through_a_wall_by_what_is_beyond_it(
    cube: BodyModel, axis: int, half: float, sign: float
) -> None:
    for place, through in ((half - 0.6, 0.0), (half - 0.5, 0.0), (half - 0.3, 0.2), (half + 7.0, 7.5)):
        T = moved(z=1.0)
        T[axis, 3] = sign * place
        assert cube.protrusion(T, BIN) == pytest.approx(through)


def test_above_the_rim_there_is_no_wall(cube: BodyModel) -> None:
    assert cube.protrusion(moved(x=4.0, z=3.6), BIN) == 0.0
    assert cube.protrusion(moved(x=4.0, z=3.4), BIN) == pytest.approx(1.5)
    diamond = rotation_about((0.0, 1.0, 0.0), np.pi / 4)  # lies over the rim on an edge, its lower corners in the bin
    assert cube.protrusion(moved(x=2.9, z=3.2, rotation=diamond), BIN) == 0.0
    assert cube.protrusion(moved(x=2.9, z=2.7, rotation=diamond), BIN) == pytest.approx(np.sqrt(0.5) - 0.1)


def test_the_worst_of_floor_and_walls_counts(cube: BodyModel) -> None:
    assert cube.protrusion(moved(x=2.7, y=1.9, z=0.4), BIN) == pytest.approx(0.4)
    assert cube.protrusion(moved(x=2.7, y=1.6, z=0.0), BIN) == pytest.approx(0.5)


@pytest.mark.parametrize("seed", range(5))
def test_a_bin_may_lie_anywhere(cube: BodyModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_world_bin = make_transform(random_rotation(rng), rng.normal(size=3))
    tilted = replace(BIN, T_world_bin=T_world_bin)
    for T_bin_part in (moved(x=2.7, z=1.0), moved(y=-1.7, z=1.0), moved(z=0.3), moved(z=0.6)):
        want = cube.protrusion(T_bin_part, BIN)
        assert cube.protrusion(T_world_bin @ T_bin_part, tilted) == pytest.approx(want, abs=1e-9)


# Sameness


def test_a_body_is_the_same_every_time(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = body(ELL)
    assert [path.name.split("-")[0] for path in folder.iterdir()] == ["body"]
    monkeypatch.setenv("BINPICK_CACHE", str(folder / "other"))
    anew = body(at.ell())

    def refuse(*_: object) -> None:
        raise RuntimeError("computed")

    monkeypatch.setattr(module, "_compute", refuse)
    read = body(at.ell())
    for again in (anew, read):
        for name in ("samples", "corners", "inside", "origin", "middle"):
            have, want = getattr(again, name), getattr(first, name)
            assert (have.dtype, have.tobytes()) == (want.dtype, want.tobytes()), name
        assert (again.cell, again.radius) == (first.cell, first.radius)
    assert read.inside.dtype == np.float32
    mesh = ELL.mesh.copy()
    mesh.vertices[0] += 1e-6
    for part in (CUBE, PartModel.from_mesh("dented", mesh)):
        with pytest.raises(RuntimeError, match="computed"):
            body(part)


def test_a_damaged_body_is_made_again(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    first = body(ELL)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with caplog.at_level(logging.WARNING):
        again = body(ELL)
    assert "computing it anew" in caplog.text
    assert again.inside.tobytes() == first.inside.tobytes()
    assert path.read_bytes() != whole[: len(whole) // 2]


# Nonsense


@pytest.mark.parametrize("name", ["depth", "overlap", "protrusion"])
@pytest.mark.parametrize("value", [-0.01, 1.0, np.nan])
def test_a_share_that_is_none_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{name} must be in \[0, 1\), got {value}"):
        BodyConfig(**{name: value})
    assert getattr(BodyConfig(**{name: 0.0}), name) == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"samples": np.zeros((4, 2))}, r"samples must be \(N, 3\), got \(4, 2\)"),
        ({"corners": np.zeros(3)}, r"corners must be \(N, 3\), got \(3,\)"),
        ({"inside": np.zeros((4, 4), np.float32)}, r"inside must be .*, got \(4, 4\)"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(ell: BodyModel, change: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(ell, **change)  # type: ignore[arg-type]
