"""Grasps on parts whose good grasps are known."""

import logging
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from perception.geometry import make_transform, random_rotation, rotation_about
from perception.part import PartModel, Symmetry
from policies.grasping.antipodal import Solid, close_pads, grasps_on_lines, opposite_faces
from policies.grasping.clearance import clear_of_floor
from policies.grasping.grasps import GraspSet, GraspSettings, flip, least_width, sample_grasps, why_no_grasp
from policies.grasping.gripper import gripper_model
from policies.grasping.outcomes import Grasp

FEW = GraspSettings(samples=250, max_grasps=600, max_checked=5000)
COARSE = GraspSettings(samples=60, max_checked=1500)
TINY = GraspSettings(samples=20, turns=4)


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("BINPICK_CACHE", str(folder))
        yield folder


def block_model():
    return PartModel.from_mesh("block", trimesh.creation.box(extents=(0.03, 0.05, 0.09)))


def tube_model():
    tube = trimesh.creation.annulus(r_min=0.015, r_max=0.020, height=0.06)
    return PartModel.from_mesh("tube", tube, Symmetry(axis=np.array([0.0, 0.0, 1.0])))


@pytest.fixture(scope="module")
def block():
    return sample_grasps(block_model(), FEW)


@pytest.fixture(scope="module")
def tube():
    return sample_grasps(tube_model(), FEW)


@pytest.mark.slow
def test_a_block_is_gripped_across_its_sides(block):
    assert len(block) > 100
    sides = np.array([0.03, 0.05])
    error = np.abs(block.width[:, None] - sides).min(axis=1)
    assert np.all(error < 1e-4)
    axis = np.abs(block.T_part_grasp[:, :3, 1])
    across = np.where(np.abs(block.width - 0.03) < 1e-3, axis[:, 0], axis[:, 1])
    assert across.min() > 0.99
    assert block.quality[0] > 0.9
    assert np.all(np.diff(block.quality) <= 0)


def test_at_contact_the_middle_of_the_pads_is_the_middle_of_the_part(block):
    closing = block.T_part_grasp[:, :3, 1]
    middle = np.sum(block.T_part_grasp[:, :3, 3] * closing, axis=1)
    np.testing.assert_allclose(middle[np.abs(closing).max(axis=1) > 0.9999], 0, atol=1e-4)


@pytest.mark.slow
def test_a_sphere_is_gripped_through_its_centre():
    sphere = PartModel.from_mesh("ball", trimesh.creation.icosphere(subdivisions=4, radius=0.02))
    grasps = sample_grasps(sphere, COARSE)
    assert len(grasps) > 100
    best = grasps.take(np.arange(20))
    np.testing.assert_allclose(best.width, 0.04, atol=1e-3)
    along = np.cross(-best.T_part_grasp[:, :3, 3], best.T_part_grasp[:, :3, 1])
    beside = np.sum(along * best.T_part_grasp[:, :3, 2], axis=1)  # lever across the approach
    assert np.abs(beside).max() < 2e-3


@pytest.mark.slow
def test_a_tube_is_gripped_across_its_bore_and_along_its_axis(tube):
    assert np.any(np.abs(tube.width - 0.04) < 1e-3)
    assert np.any(np.abs(tube.width - 0.06) < 1e-3)


def test_a_solid_of_revolution_has_grasps_all_around(tube):
    across = tube.T_part_grasp[np.abs(tube.width - 0.04) < 1e-3]
    azimuth = np.arctan2(across[:, 1, 2], across[:, 0, 2])[np.abs(across[:, 2, 2]) < 0.5]
    sectors = np.unique(np.floor((azimuth + np.pi) / (2 * np.pi) * 12 - 1e-9))
    assert len(sectors) >= 12


@pytest.mark.parametrize("name", ["block", "tube"])
def test_grasps_are_valid_and_cover_every_way_up(name, request):
    grasps = request.getfixturevalue(name)
    R = grasps.T_part_grasp[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-9)
    assert np.all((grasps.quality >= 0) & (grasps.quality <= 1))
    assert np.all((grasps.width >= FEW.min_width) & (grasps.width <= FEW.max_width))
    assert np.all(grasps.clear.any(axis=1))
    assert np.all((grasps.width[:, None] + 2 * grasps.extras)[grasps.clear] <= FEW.max_opening)
    rng = np.random.default_rng(3)
    for _ in range(100):
        down = -(grasps.T_part_grasp[:, :3, 2] @ random_rotation(rng).T)[:, 2]
        assert down.max() > np.cos(np.radians(45))


@pytest.mark.parametrize("make", [block_model, tube_model])
def test_no_gripper_point_lies_inside_the_part(make, request):
    model, gripper = make(), gripper_model()
    grasps = request.getfixturevalue(model.name)
    for n in np.linspace(0, len(grasps) - 1, 8).astype(int):
        extra = grasps.extras[np.flatnonzero(grasps.clear[n])[-1]]
        T = gripper.tcp_from_grasp(grasps.T_part_grasp[n : n + 1], grasps.width[n : n + 1])[0]
        for gap, retreat in ((2 * extra, 0.0), (extra, 0.0), (0.0015, 0.0), (2 * extra, 0.03)):
            points = gripper.hull_points(grasps.width[n] + gap) - [0, 0, retreat]
            inside = model.mesh.contains(points @ T[:3, :3].T + T[:3, 3])
            assert not inside.any()


def test_same_seed_same_grasps_and_the_cache_returns_them(monkeypatch, tmp_path):
    first = sample_grasps(block_model(), TINY)
    again = sample_grasps(block_model(), TINY)
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path))
    anew = sample_grasps(block_model(), TINY)
    for grasps in (again, anew):
        np.testing.assert_array_equal(grasps.T_part_grasp, first.T_part_grasp)
        np.testing.assert_array_equal(grasps.clear, first.clear)
        np.testing.assert_array_equal(grasps.surface, first.surface)
    other = sample_grasps(block_model(), TINY, seed=1)
    assert other.T_part_grasp.shape != first.T_part_grasp.shape or not np.allclose(other.quality, first.quality)


def test_a_spoilt_cache_file_is_computed_anew(monkeypatch, tmp_path, caplog):
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path))
    first = sample_grasps(block_model(), TINY)
    (stored,) = tmp_path.glob("grasps-*.npz")
    stored.write_bytes(b"spoilt")
    with caplog.at_level(logging.WARNING):
        second = sample_grasps(block_model(), TINY)
    assert "computing it anew" in caplog.text
    np.testing.assert_array_equal(first.T_part_grasp, second.T_part_grasp)
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.slow
def test_a_part_too_large_for_the_jaw_has_no_grasp(caplog):
    cube = PartModel.from_mesh("cube", trimesh.creation.box(extents=(0.1, 0.1, 0.1)))
    with caplog.at_level(logging.INFO):
        grasps = sample_grasps(cube, FEW)
    assert len(grasps) == 0
    assert grasps.T_part_grasp.shape == (0, 4, 4)
    assert "no grasp on cube; left after each step of the search: 0 lines through the part, 0 poses" in caplog.text


@pytest.mark.slow
def test_a_narrower_jaw_grasps_what_fits_into_it():
    """Across 30 mm of the block, but not across 50 mm, and never opened wider than the jaw."""
    grasps = sample_grasps(block_model(), FEW, jaw=0.05)
    np.testing.assert_allclose(grasps.width, 0.03, atol=1e-4)
    assert np.all((grasps.width[:, None] + 2 * grasps.extras)[grasps.clear] <= 0.049)
    just = PartModel.from_mesh("just", trimesh.creation.box(extents=(0.0429, 0.09, 0.09)))
    assert len(sample_grasps(just, FEW, jaw=0.05)) > 0
    assert "its pads can reach; its whole stroke of 85 mm finds grasps from 43 mm on" in why_no_grasp(
        just, FEW, jaw=0.05
    )


@pytest.mark.slow
def test_a_part_that_needs_60_mm_says_so_to_a_jaw_of_50_mm():
    cube = PartModel.from_mesh("cube", trimesh.creation.box(extents=(0.06, 0.06, 0.06)))
    assert len(sample_grasps(cube, FEW)) > 0
    assert len(sample_grasps(cube, FEW, jaw=0.05)) == 0
    reason = why_no_grasp(cube, FEW, jaw=0.05)
    assert reason == (
        "the jaw (stroke 50 mm) finds no grasp on 'cube': it takes at most 43 mm between two opposite faces, "
        "and the nearest two are 60 mm apart"
    )


def test_the_nearest_opposite_faces_do_not_depend_on_the_jaw():
    cube = PartModel.from_mesh("cube", trimesh.creation.box(extents=(0.12, 0.11, 0.1)))
    assert least_width(cube, FEW) == pytest.approx(0.1)
    corners = [(0.04, 0.0, 0.0), (-0.02, 0.035, 0.0), (-0.02, -0.035, 0.0), (0.0, 0.0, 0.06)]
    assert least_width(PartModel.from_mesh("cone", trimesh.convex.convex_hull(corners)), FEW) == np.inf


def test_a_jaw_as_wide_as_the_stroke_changes_no_setting():
    assert GraspSettings().limited_to(0.085) == GraspSettings()
    with pytest.raises(ValueError, match=r"jaw must exceed 10 mm to grasp anything, got 9\.0 mm"):
        GraspSettings().limited_to(0.009)


def test_closing_finds_what_protrudes_before_the_faces():
    # A 2 mm rib on one face holds the pads 2 mm further apart and shifts the middle by 1 mm.
    body = trimesh.creation.box(extents=(0.04, 0.03, 0.06))
    rib = trimesh.creation.box(bounds=[(-0.02, 0.0149, -0.005), (0.02, 0.017, 0.005)])
    part = trimesh.boolean.union([body, rib], engine="manifold")
    T = make_transform(rotation_about((1, 0, 0), 0.0), (0, 0, 0.0187))[None]
    contacts = close_pads(part, T, np.array([0.03]))
    assert contacts.width[0] == pytest.approx(0.032, abs=1e-6)
    assert contacts.shift[0] == pytest.approx(0.001, abs=1e-6)
    assert contacts.alignment[0] == pytest.approx(1.0)
    assert 0.1 < contacts.area[0] < 0.5


def test_finer_rays_find_a_shallow_contact():
    # The pads' last 1.5 mm hold a plate of 4 mm; the first row of rays 4 mm apart lies 2 mm behind the fingertips.
    plate = trimesh.creation.box(extents=(0.06, 0.03, 0.004))
    T = make_transform(rotation_about((1, 0, 0), np.pi), (0, 0, 0.0005))[None]  # down, to 1.5 mm under the top face
    coarse, fine = (close_pads(plate, T, np.array([0.03]), scale) for scale in (1.0, 0.5))
    assert coarse.area[0] == 0
    assert fine.area[0] == pytest.approx(1 / 18)  # one of 18 rows
    assert fine.width[0] == pytest.approx(0.03, abs=1e-6)


@pytest.mark.parametrize("most", [20, 60, 100, 140])
def test_of_a_thin_part_no_more_poses_are_checked_than_asked_for(most, monkeypatch):
    checked = []

    def close(mesh, T, *arguments):
        checked.append(T)
        return close_pads(mesh, T, *arguments)

    monkeypatch.setattr("policies.grasping.grasps.close_pads", close)
    plate = PartModel.from_mesh("plate", trimesh.creation.box(extents=(0.06, 0.05, 0.011)))
    sample_grasps(plate, GraspSettings(samples=60, turns=1, depths=(0.0,), max_checked=most), seed=most)
    assert len(checked[0]) == most
    # The fingertips of the first ones end 1.3 or 2.8 mm above the one broad side or the other.
    assert (
        np.sum(np.isclose(np.abs(checked[0][:, 2, 3]), 0.0042) | np.isclose(np.abs(checked[0][:, 2, 3]), 0.0027))
        >= most // 4
    )


@pytest.mark.parametrize("thickness", [0.004, 0.006])
def test_a_plate_on_the_floor_can_be_picked_up_by_its_rim(thickness):
    plate = PartModel.from_mesh("plate", trimesh.creation.box(extents=(0.06, 0.04, thickness)))
    grasps = sample_grasps(plate, GraspSettings(samples=40, turns=4))
    clear = clear_of_floor(make_transform(None, (0, 0, thickness / 2)), grasps, gripper_model())
    assert clear.sum() >= 10
    assert grasps.width[clear].min() > 0.039


def test_the_grid_stays_as_it_is_for_a_part_that_is_not_thin():
    model = PartModel.from_mesh("block", trimesh.creation.box(extents=(0.03, 0.05, 0.0121)))
    as_thick = sample_grasps(model, replace(TINY, thin=1e-6))
    assert len(as_thick) > 100
    np.testing.assert_array_equal(sample_grasps(model, TINY).T_part_grasp, as_thick.T_part_grasp)


def test_patches_that_do_not_lie_opposite_are_no_grasp():
    """Two lobes that overlap by 4 mm only: pads along them would turn the part between them."""
    lobes = [((-0.015, -0.001, 0.0), (0.015, 0.015, 0.022)), ((-0.015, -0.015, 0.018), (0.015, 0.001, 0.04))]
    mesh = trimesh.boolean.union([trimesh.creation.box(bounds=bounds) for bounds in lobes], engine="manifold")
    grasps = sample_grasps(PartModel.from_mesh("zed", mesh), COARSE)
    assert len(grasps) > 0
    contacts = close_pads(mesh, grasps.T_part_grasp, grasps.width)
    assert np.all(contacts.offset <= 0.4 * np.maximum(contacts.width, 0.01) + 1e-6)


def test_pads_that_meet_nothing_have_no_width():
    cube = trimesh.creation.box(extents=(0.01,) * 3)
    contacts = close_pads(cube, make_transform(None, (0.5, 0, 0))[None], np.ones(1))
    assert contacts.width[0] == -np.inf
    assert contacts.area[0] == 0


def test_lines_pair_opposite_faces_and_turns_go_all_around():
    mesh = trimesh.creation.box(extents=(0.03, 0.05, 0.2))
    first, second = opposite_faces(mesh, 200, 0.93, (0.003, 0.078), seed=0)
    gap = np.linalg.norm(second - first, axis=1)
    assert np.all((gap > 0.0299) & (gap < 0.0541))
    T, widths = grasps_on_lines(first[:1], second[:1], turns=8, depths=(0.0, 0.01))
    assert T.shape == (16, 4, 4)
    np.testing.assert_allclose(widths, gap[0])
    np.testing.assert_allclose(T[:, :3, 2].sum(axis=0), 0, atol=1e-12)
    middle = (first[0] + second[0]) / 2
    depth = np.sum((T[:, :3, 3] - middle) * T[:, :3, 2], axis=1)
    np.testing.assert_allclose(depth, np.tile((0.0, 0.01), 8), atol=1e-12)


def test_the_line_through_a_wedge_leans_alike_on_both_faces():
    lean = np.tan(np.radians(8))
    corners = [(x, s * (0.02 + lean * z), z) for x in (-0.03, 0.03) for z in (-0.03, 0.03) for s in (-1, 1)]
    wedge = trimesh.convex.convex_hull(np.array(corners))
    first, second = opposite_faces(wedge, 300, 0.928, (0.003, 0.078), seed=0)
    line = (second - first) / np.linalg.norm(second - first, axis=1, keepdims=True)
    across = np.abs(line[:, 1]) > 0.9
    assert across.sum() > 50
    np.testing.assert_allclose(np.abs(line[across, 1]), 1, atol=1e-9)


def test_signed_distance_of_a_sphere():
    solid = Solid.from_mesh(trimesh.creation.icosphere(subdivisions=4, radius=0.02))
    index = np.stack(np.meshgrid(*[np.arange(n) for n in solid.field.shape], indexing="ij"), axis=-1)
    exact = np.linalg.norm(solid.origin + index * solid.voxel, axis=-1) - 0.02
    assert np.abs(solid.field - exact).max() < solid.voxel


def test_flip_turns_the_jaw_and_keeps_the_approach(block):
    flipped = flip(block.T_part_grasp)
    np.testing.assert_allclose(flipped[:, :3, 2:], block.T_part_grasp[:, :3, 2:])
    np.testing.assert_allclose(flipped[:, :3, 1], -block.T_part_grasp[:, :3, 1])
    np.testing.assert_allclose(np.linalg.det(flipped[:, :3, :3]), 1)
    np.testing.assert_allclose(flip(flipped), block.T_part_grasp)


def test_a_set_gives_single_grasps(block):
    assert isinstance(block, GraspSet)
    grasp = block[3]
    assert isinstance(grasp, Grasp)
    assert grasp.width == block.width[3]


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"samples": 0}, "samples must be at least 1, got 0"),
        ({"thin": 0.0}, "thin must be positive"),
        ({"friction": 0.0}, "friction must be in"),
        ({"max_width": 0.09}, "min_width < max_width < max_opening"),
        ({"extras": (0.01, 0.005)}, "extras must rise"),
        ({"depths": ()}, "depths must not be empty"),
    ],
)
def test_settings_reject_nonsense(wrong, text):
    with pytest.raises(ValueError, match=text):
        GraspSettings(**wrong)
