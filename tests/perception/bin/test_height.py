"""A bin whose stated size is wrong by much: the height is measured where the floor is seen, the rest is named."""

import numpy as np
import pytest

from perception.bin import find_bin, reconcile
from perception.diagnosis import BinFacts, bin_size_cause
from perception.geometry import invert_transform, make_transform
from tests.perception.bin import box_scene as scene

AT = scene.view()
EMPTY = [scene.TABLE, *scene.walls()]
PILE = [*EMPTY, *scene.blocks(30)]
HEAP = [*EMPTY, *scene.blocks(120)]  # a sixth of the floor is seen between the parts


def stated(length: float = 0.0, width: float = 0.0, height: float = 0.0) -> np.ndarray:
    """Return the size of the bin, wrong by these lengths."""
    return scene.INNER + np.array([length, width, height])


@pytest.mark.slow
@pytest.mark.parametrize("boxes", [EMPTY, PILE, HEAP], ids=["empty", "pile", "heap"])
@pytest.mark.parametrize("near", [True, False])
@pytest.mark.parametrize("wrong", [-0.08, -0.02])
def test_a_height_stated_too_small_by_much_is_measured_and_named(
    boxes: list[scene.Box], near: bool, wrong: float
) -> None:
    size = stated(height=wrong)
    fit = find_bin(AT.see(boxes), size, scene.workspace(AT, size) if near else None)
    assert fit.reliable
    assert "floor" in fit.seen
    assert fit.T_world_bin is not None
    assert (invert_transform(AT.T_world_bin) @ fit.T_world_bin)[2, 3] == pytest.approx(0.0, abs=0.0005)
    assert fit.height == pytest.approx(scene.INNER[2], abs=0.0005)
    np.testing.assert_allclose(fit.inner_size, scene.INNER, atol=0.0005)
    cause = bin_size_cause(fit, size, ())
    assert cause is not None
    assert f"inner_size height stated {1000 * size[2]:.0f} mm, measured 120 mm" in cause.text


@pytest.mark.parametrize("boxes", [EMPTY, PILE, HEAP], ids=["empty", "pile", "heap"])
@pytest.mark.parametrize("wrong", [0.012, 0.03, 0.12])
def test_a_height_stated_too_large_by_much_is_named(boxes: list[scene.Box], wrong: float) -> None:
    size = stated(height=wrong)
    fit = find_bin(AT.see(boxes), size, scene.workspace(AT, size))
    cause = bin_size_cause(fit, size, ())
    assert "floor" not in fit.seen
    assert fit.height == pytest.approx(scene.INNER[2], abs=0.002)
    assert cause is not None
    assert f"inner_size height stated {1000 * size[2]:.0f} mm, " in cause.text
    assert "120 mm" in cause.text


@pytest.mark.parametrize("near", [True, False])
@pytest.mark.parametrize("gap", [0.0, 0.0005])
def test_a_layer_of_parts_that_hides_the_floor_is_not_taken_for_it(gap: float, near: bool) -> None:
    """Blocks of 40 mm, 50 mm high, lie side by side from wall to wall."""
    starts = [np.arange(-side / 2, side / 2 - 0.001, 0.04) for side in scene.INNER[:2]]
    corners = [(float(x), float(y)) for x in starts[0] for y in starts[1]]
    ends = [tuple(min(c + 0.04 - gap, side / 2) for c, side in zip(at, scene.INNER[:2], strict=True)) for at in corners]
    layer: list[scene.Box] = [((*at, 0.0), (*end, 0.05)) for at, end in zip(corners, ends, strict=True)]
    frame, believed = AT.see([*EMPTY, *layer]), scene.workspace(AT)
    fit = find_bin(frame, scene.INNER, believed if near else None)
    assert fit.T_world_bin is not None
    assert (invert_transform(AT.T_world_bin) @ fit.T_world_bin)[2, 3] == pytest.approx(0.0, abs=0.001)
    np.testing.assert_array_equal(fit.inner_size, scene.INNER)
    cause = bin_size_cause(fit, scene.INNER, ())
    assert cause is None or "parts fill the bin up to it, or the height is wrong" in cause.text


def test_the_measured_height_is_that_of_the_bin_in_which_poses_are_searched() -> None:
    frame, believed = AT.see(PILE), scene.workspace(AT, stated(height=-0.03))
    _, found = reconcile(frame, believed, find_bin(frame, believed.inner_size, believed), "camera")
    np.testing.assert_allclose(found.inner_size, scene.INNER, atol=0.0005)
    right = scene.workspace(AT)
    _, same = reconcile(frame, right, find_bin(frame, right.inner_size, right), "camera")
    np.testing.assert_array_equal(same.inner_size, right.inner_size)


@pytest.mark.parametrize(("slat", "gap"), [(0.02, 0.01), (0.04, 0.005), (0.1, 0.01)])
def test_what_a_perforated_floor_stands_on_is_not_its_floor(slat: float, gap: float) -> None:
    starts = np.arange(-0.18, 0.18 - slat / 2, slat + gap).tolist()
    slats = [((x, -0.13, -0.002), (min(x + slat, 0.18), 0.13, 0.0)) for x in starts]
    ground: scene.Box = ((-2.0, -2.0, -0.2), (2.0, 2.0, -0.03))
    fit = find_bin(AT.see([ground, *scene.walls()[1:], *slats]), scene.INNER, scene.workspace(AT))
    assert fit.T_world_bin is not None
    assert (invert_transform(AT.T_world_bin) @ fit.T_world_bin)[2, 3] == pytest.approx(0.0, abs=0.001)
    np.testing.assert_array_equal(fit.inner_size, scene.INNER)


def test_a_height_that_is_a_little_too_large_may_be_flat_parts_and_is_said() -> None:
    believed = scene.workspace(AT, stated(height=0.006))
    fit = find_bin(AT.see(EMPTY), believed.inner_size, believed)
    assert "floor" not in fit.seen
    assert "stated height of 126 mm puts it: flat parts cover it, or it is 120 mm" in str(BinFacts.of(fit, believed))


def full() -> list[scene.Box]:
    """Return a bin whose floor is hidden by columns of any height."""
    rng = np.random.default_rng(0)
    corners = [(float(x), float(y)) for x in np.arange(-0.18, 0.18, 0.02) for y in np.arange(-0.13, 0.13, 0.02)]
    tops = rng.uniform(0.03, 0.09, len(corners)).tolist()
    return [*EMPTY, *(((x, y, 0.0), (x + 0.02, y + 0.02, top)) for (x, y), top in zip(corners, tops, strict=True))]


def test_a_full_bin_has_no_level_that_could_be_its_floor() -> None:
    fit = find_bin(AT.see(full()), scene.INNER, scene.workspace(AT))
    assert fit.reliable
    assert np.isnan(fit.height)
    assert "puts it" in str(BinFacts.of(fit, scene.workspace(AT)))


@pytest.mark.parametrize(
    ("wrong", "near", "text"),
    [
        (-0.06, True, "stated 60 mm, the frame suggests at least 120 mm (its rim lies 60 mm above where"),
        (0.12, True, "stated 240 mm, the frame suggests at least 120 mm (its rim lies 120 mm below where"),
        (-0.065, False, "stated 55 mm, the frame suggests at least 8"),
    ],
)
def test_the_height_is_named_where_no_floor_is_seen(wrong: float, near: bool, text: str) -> None:
    size = stated(height=wrong)
    fit = find_bin(AT.see(full()), size, scene.workspace(AT, size) if near else None)
    assert not fit.reliable
    cause = bin_size_cause(fit, size, ())
    assert cause is not None
    assert f"inner_size height {text}" in cause.text


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [(0.3, 0.0), (0.0, 0.2), (0.36, 0.26), (0.03, 0.0)])
@pytest.mark.parametrize("boxes", [PILE, HEAP], ids=["pile", "heap"])
def test_a_length_or_width_stated_wrong_by_much_is_named(boxes: list[scene.Box], wrong: tuple[float, float]) -> None:
    size = stated(*wrong)
    fit = find_bin(AT.see(boxes), size, scene.workspace(AT, size))
    assert not fit.reliable
    np.testing.assert_allclose(fit.opening, scene.INNER[:2], atol=0.005)
    assert fit.reason is not None
    assert f"but inner_size says {1000 * size[0]:.0f} x {1000 * size[1]:.0f} mm" in fit.reason


def test_a_bin_far_below_where_it_is_said_to_be_has_no_other_height() -> None:
    aside = scene.workspace(AT)
    high = AT.T_world_bin @ make_transform(translation=(0.0, 0.0, 0.1))
    fit = find_bin(AT.see(EMPTY), aside.inner_size, type(aside)(T_world_bin=high, inner_size=aside.inner_size))
    assert fit.reason == "its rim lies 100 mm below where its pose and the stated height put it"
    assert fit.T_world_bin is high
