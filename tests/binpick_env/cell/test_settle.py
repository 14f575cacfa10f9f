"""Dropping piles: the same seed gives the same bits, everything sleeps inside the bin, and nothing overlaps."""

import logging
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from binpick_env.cell import settle
from binpick_env.cell.settle import SettleError, drop_and_settle, inside_bin
from binpick_env.cell.simulation import Simulation
from binpick_env.config import BinConfig, CellConfig, ContactConfig
from binpick_env.parts.design import Design
from binpick_env.parts.part import _assemble
from perception.geometry import Floats, transform_points
from perception.part import Symmetry
from tests.binpick_env.small_cell import centred, deepest_overlap, small_simulation

COUNT = 12
PILES = 14  # whose mean heights are compared


def drop(simulation: Simulation, seed: int, count: int = COUNT) -> Floats:
    drop_and_settle(simulation, count, np.random.default_rng(seed))
    return simulation.part_poses()


@pytest.fixture(scope="module")
def shared() -> Simulation:
    return small_simulation(COUNT)


@pytest.fixture(scope="module")
def pile(shared: Simulation) -> Simulation:
    """Return the cell with the pile of seed 1, which nothing here moves."""
    simulation = small_simulation(COUNT + 2)
    drop(simulation, seed=1)
    return simulation


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits(shared: Simulation) -> None:
    first = drop(shared, seed=1, count=6)
    other = drop(shared, seed=2, count=6)
    assert np.abs(first - other)[:6].max() > 0.01
    np.testing.assert_array_equal(drop(shared, seed=1, count=6), first)
    np.testing.assert_array_equal(drop(small_simulation(COUNT), seed=1, count=6), first)


def test_a_pile_that_takes_long_says_how_far_it_is(
    shared: Simulation, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now = iter(range(0, 100_000, 5))
    monkeypatch.setattr(settle.time, "monotonic", lambda: float(next(now)))
    drop(shared, seed=3, count=6)
    said = [re.fullmatch(r"(\d+) of 6 parts are dropped and (\d) lie still after (\d+) s", m) for m in caplog.messages]
    assert all(said)
    assert [int(each[3]) for each in said if each][:2] == [15, 30]
    assert said[-1] is not None
    assert said[-1][1] == "6"


def test_what_happened_before_leaves_no_trace(shared: Simulation) -> None:
    first = drop(shared, seed=3, count=4)
    shared.place(7, centred(shared, (0.5, 0.0, 0.3)))
    for _ in range(20):
        shared.step(shared.target - 0.1, 1.0)
    np.testing.assert_array_equal(drop(shared, seed=3, count=4), first)


def test_the_arm_stands_at_home_open(pile: Simulation) -> None:
    np.testing.assert_allclose(pile.joint_positions, pile.target, atol=1e-3)
    assert pile.gripper_position < 0.01


def test_all_sleep_inside_the_bin(pile: Simulation) -> None:
    np.testing.assert_array_equal(pile.in_play, [True] * COUNT + [False] * 2)
    assert pile.asleep().all()
    np.testing.assert_array_equal(pile.part_speeds(), 0.0)
    np.testing.assert_array_equal(inside_bin(pile), pile.in_play)
    workspace = pile.config.bin.workspace()
    vertices = np.asarray(pile.part.model.mesh.vertices)
    for pose in pile.part_poses()[:COUNT]:
        points_bin = workspace.to_bin(transform_points(pose, vertices))
        low = points_bin[points_bin[:, 2] < workspace.inner_size[2]]  # those above the rim may lean over it
        assert (np.abs(low[:, :2]) < workspace.inner_size[:2] / 2 + 0.0015).all()
        assert points_bin[:, 2].min() > -0.0015


def test_nothing_interpenetrates(pile: Simulation) -> None:
    assert deepest_overlap(pile) < 0.0015


def test_nothing_hovers(pile: Simulation) -> None:
    """Fallen asleep, every part rests on something: awake again, the pile moves by no more than a hair."""
    simulation = small_simulation(COUNT + 2)
    for i, pose in enumerate(pile.part_poses()[:COUNT]):
        simulation.place(i, pose)
    before = simulation.part_centres()
    for _ in range(12):
        simulation.step(simulation.target, 0.0)
    moved = np.linalg.norm(simulation.part_centres() - before, axis=1)
    assert np.median(moved) < 5e-4
    assert moved.max() < 5e-3


def test_an_empty_bin_is_a_pile_too(shared: Simulation) -> None:
    drop(shared, seed=0, count=0)
    assert not shared.in_play.any()
    assert not inside_bin(shared).any()


def test_inside_bin_by_hand(shared: Simulation) -> None:
    shared.reset()
    places = [(0.5, 0.0, 0.05), (0.5, 0.175, 0.2), (0.5, 0.0, 0.27), (0.5, 0.19, 0.05), (0.64, 0.0, 0.05)]
    for i, place in enumerate(places):  # the bin's long side runs along the world's y; twice its rim is at 0.26
        shared.place(i, centred(shared, place))
    np.testing.assert_array_equal(inside_bin(shared)[:6], [True, True, False, False, False, False])


@pytest.mark.parametrize("count", [-1, COUNT + 1])
def test_a_count_out_of_range_is_an_error(shared: Simulation, count: int) -> None:
    with pytest.raises(ValueError, match=rf"count must be in 0\.\.{COUNT}, got {count}"):
        drop(shared, seed=0, count=count)


def test_too_many_parts_in_a_tiny_bin_are_an_error(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(settle, "ATTEMPTS", 1)
    tiny = replace(CellConfig(), bin=BinConfig(inner_size=(0.06, 0.06, 0.2)))
    text = r"4 parts of d_max 9\d mm do not come to rest in a bin of \(0\.06, 0\.06, 0\.2\) m; use fewer parts"
    with caplog.at_level(logging.INFO), pytest.raises(SettleError, match=text):
        drop(small_simulation(4, tiny), seed=0, count=4)
    assert "pile 1 of at most 1 with 4 parts did not come to rest in the bin" in caplog.text


def test_a_heap_that_cannot_lie_in_the_bin_is_refused_before_it_is_dropped() -> None:
    tiny = replace(CellConfig(), bin=BinConfig(inner_size=(0.05, 0.05, 0.01)))
    with pytest.raises(ValueError, match=r"4 parts of d_max 92 mm do not fit into a bin of 50 x 50 x 10 mm"):
        drop(small_simulation(4, tiny), seed=0, count=4)


def test_a_part_under_the_floor_is_an_error_and_is_not_dropped_again(
    shared: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    release = settle._release

    def sink_one(simulation: Simulation, parts: list[int], rng: np.random.Generator, progress: Any) -> None:
        release(simulation, parts, rng, progress)
        simulation.place(0, centred(simulation, (0.5, 0.0, -0.3)))

    monkeypatch.setattr(settle, "_release", sink_one)
    monkeypatch.setattr(settle, "_settle", lambda *_: True)
    with pytest.raises(SettleError, match=r"1 part fell through the floor of the bin: .* time step of 0.002 s"):
        drop(shared, seed=0, count=2)


def test_a_thin_part_that_lies_a_little_in_the_floor_is_in_the_bin(
    shared: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contacts give way by 0.1 mm, which is half of the thinnest plate."""
    release = settle._release

    def sink_one(simulation: Simulation, parts: list[int], rng: np.random.Generator, progress: Any) -> None:
        release(simulation, parts, rng, progress)
        simulation.place(0, centred(simulation, (0.5, 0.0, simulation.config.bin.wall - 0.00005)))

    monkeypatch.setattr(settle, "_release", sink_one)
    monkeypatch.setattr(settle, "_settle", lambda *_: True)
    drop(shared, seed=0, count=1)
    assert shared.part_centres()[0, 2] < shared.config.bin.wall
    assert inside_bin(shared)[0]


@pytest.mark.slow
@pytest.mark.parametrize(("wall", "height"), [(0.005, 0.12), (0.01, 0.12), (0.02, 0.4)])
def test_thin_plates_do_not_fall_through_a_floor(wall: float, height: float) -> None:
    plate = trimesh.creation.box((0.06, 0.04, 0.001))
    part = _assemble(
        Design(name="plate", mesh=plate, pieces=(plate.copy(),), density=2700.0, symmetry=Symmetry()), source="plate"
    )
    simulation = Simulation(
        replace(CellConfig(), bin=BinConfig(inner_size=(0.36, 0.26, height), wall=wall)), part, COUNT
    )
    for seed in range(3):
        drop(simulation, seed)


@pytest.mark.slow
def test_thin_plates_do_not_pass_through_each_other() -> None:
    """Crossed plates are picked together. With the contacts of thick parts they are up to 2.6 mm deep in each other."""
    bodies = [trimesh.creation.box((0.048, 0.045, 0.005)), trimesh.creation.box((0.022, 0.029, 0.005))]
    for body, place in zip(bodies, ((-0.011, 0.0, 0.0), (0.024, -0.008, 0.0)), strict=True):
        body.apply_translation(place)
    plate = trimesh.boolean.union(bodies, engine="manifold")
    part = _assemble(
        Design(name="plate", mesh=plate, pieces=tuple(bodies), density=2700.0, symmetry=Symmetry()), source="plate"
    )
    simulation = Simulation(CellConfig(), part, 20)
    for seed in range(4):
        drop(simulation, seed, 20)
        assert deepest_overlap(simulation) < 5e-4


def test_a_diverging_pile_is_drawn_again(shared: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo used to hide a NaN by putting the parts back to where the model parks them."""
    release, calls = settle._release, []

    def diverge_once(simulation: Simulation, parts: list[int], rng: np.random.Generator, progress: Any) -> None:
        release(simulation, parts, rng, progress)
        if not calls:
            simulation.data.qvel[-1] = np.nan
        calls.append(len(parts))

    monkeypatch.setattr(settle, "_release", diverge_once)
    drop(shared, seed=0, count=4)
    assert calls[:2] == [4, 4]
    assert inside_bin(shared)[:4].all()


@pytest.mark.slow
def test_damping_is_honest() -> None:
    """Half or twice the damping leaves the height at which parts rest where it is, up to the noise between piles."""
    heights = {}
    for damping in (5e-5, 2e-4):
        simulation = small_simulation(COUNT, replace(CellConfig(), contact=ContactConfig(joint_damping=damping)))
        heights[damping] = [drop(simulation, seed)[:, 2, 3].mean() for seed in range(PILES)]
    low, high = heights.values()
    error = np.sqrt((np.var(low, ddof=1) + np.var(high, ddof=1)) / PILES)
    assert error < 0.002
    assert abs(np.mean(low) - np.mean(high)) < 3 * error
