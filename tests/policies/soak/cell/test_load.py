"""The soak test of load: what runs side by side does the same as alone."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binpick_env.jobs.process_map import WorkerError
from policies.soak.cell import LoadSoak, crowd, load, shared_pipelines
from policies.soak.cell.crowd import Deeds, Member, pick_alone, pick_together

DEEDS = Deeds(digests=("a", "b", "c"), seconds=9.0, decisions=2, error="")
MEMBER = Member(part="tee", seed=1, perception="oracle", fast=True, num_parts=(2, 3), seconds=4.0)
SMALL = LoadSoak(
    seconds=1, environments=2, learned=1, alone=2, threads=2, chunk=4, parts=("tee", "bracket"), num_parts=(2, 3)
)
COMPILE_KERNELS = load.compile_kernels


def in_this_process(work: Callable[[int], Any], indices: Sequence[int], workers: int) -> Iterator[Any]:
    return map(work, indices)


@pytest.fixture(autouse=True)
def compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nothing be compiled before a unit."""
    monkeypatch.setattr(load, "compile_kernels", lambda _: None)


@pytest.mark.slow
def test_what_runs_side_by_side_does_the_same_as_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load, "map_indices", in_this_process)
    result = SMALL.run(SMALL.units()[0], tmp_path)
    assert result.problems == ()
    assert result.counts["of them compared with the same alone"] == 2
    assert result.counts["simulated seconds"] >= 4
    assert result.counts["frames on shared pipelines"] == 4


class Toy:
    """An environment whose state is the sum of its actions, and that ends an episode after two of them."""

    def __init__(self, **arguments: Any) -> None:
        self.cell = self
        self.simulation = self
        self.data = self
        self.time, self.qpos, self.qvel = 0.0, np.zeros(1), np.zeros(1)
        self.maxuse_arena = 0
        self.action_space = type("Rows", (), {"n": 32})

    def reset(self, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
        self.time = 0.0
        self.qpos = np.array([float(seed)])
        return {"seen": self.qpos}, {}

    def action_masks(self) -> np.ndarray:
        return np.ones(32, bool)

    def step(self, row: np.int64) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.time += 1.0
        self.qpos = self.qpos + float(row)
        return {"seen": self.qpos}, 1.0, self.time >= 2.0, False, {}

    def close(self) -> None:
        pass


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crowd, "GraspSelectionEnv", Toy)


@pytest.mark.usefixtures("toys")
def test_a_member_picks_until_its_time_is_over() -> None:
    deeds = pick_alone(MEMBER)
    assert (deeds.seconds, deeds.decisions, len(deeds.digests), deeds.error) == (4.0, 4, 6, "")
    assert len(set(deeds.digests)) == 6
    assert pick_alone(MEMBER) == deeds
    assert pick_alone(replace(MEMBER, seed=2)).digests[0] != deeds.digests[0]


def test_compiling_is_over_before_the_memory_of_a_unit_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling in a unit let its memory grow by 102 MB on a machine that had no kernels."""
    calls: list[str] = []
    monkeypatch.setattr(load, "pick_alone", lambda member: calls.append(f"{member.part} {member.seconds:g} s"))

    def found(*_: Any, **__: Any) -> list[Any]:
        calls.append("unit")
        return [(0, ([DEEDS, DEEDS], 0.0)), (1, [DEEDS, DEEDS]), (2, (4, []))]

    monkeypatch.setattr(load, "map_indices", found)
    monkeypatch.setattr(load, "compile_kernels", COMPILE_KERNELS)
    soak = replace(SMALL, seconds=9)  # two units; what is compiled once is compiled for no other test
    for unit in soak.units():
        soak.run(unit, tmp_path)
    assert calls == ["tee 1 s", "bracket 1 s", "unit", "unit"]


@pytest.mark.usefixtures("toys")
def test_members_do_the_same_together() -> None:
    members = [replace(MEMBER, seed=k, seconds=2.0 + k) for k in range(5)]
    together, _ = pick_together(members, threads=3)
    assert together == [pick_alone(member) for member in members]


@pytest.mark.usefixtures("toys")
def test_memory_for_contacts_is_no_growth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of 16 piles, of gears, took 160 MB for their contacts in the second half of a unit."""
    step, held = Toy.step, [0.0]

    def touching(self: Toy, row: np.int64) -> Any:
        self.maxuse_arena += 3 * 1024**2
        held[0] += 3.0 + leaked
        return step(self, row)

    monkeypatch.setattr(Toy, "step", touching)
    monkeypatch.setattr(crowd, "resident_mb", lambda: 500.0 + held[0])
    for leaked in (0.0, 2.0):
        assert pick_together([MEMBER, MEMBER], threads=1)[1] == 2 * 2 * leaked


@pytest.mark.usefixtures("toys")
def test_environments_that_share_what_they_should_not_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here a number that grows with every step of any of them."""
    total = [0.0]
    step = Toy.step

    def leaking(self: Toy, row: np.int64) -> Any:
        total[0] += 1.0
        self.qvel = np.array(total)
        return step(self, row)

    monkeypatch.setattr(Toy, "step", leaking)
    monkeypatch.setattr(load, "map_indices", in_this_process)
    monkeypatch.setattr(load, "differences", lambda *_: (4, ["tee, frame 1: other poses"]))
    first, second, pipelines = SMALL.run("00000", tmp_path).problems
    assert first.startswith("tee, learned, f")
    assert "differs from reset or decision 1 on" in first
    assert second.startswith("bracket, oracle, f")
    assert pipelines == "tee, frame 1: other poses"


@pytest.mark.usefixtures("toys")
def test_an_exception_ends_its_member_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reset = Toy.reset

    def broken(self: Toy, seed: int) -> Any:
        if seed == broken_seed:
            raise FloatingPointError("the physics diverged")
        return reset(self, seed)

    members = SMALL.members(0)
    broken_seed = int(np.random.default_rng(members[1].seed).integers(2**31))
    monkeypatch.setattr(Toy, "reset", broken)
    monkeypatch.setattr(load, "map_indices", in_this_process)
    monkeypatch.setattr(load, "differences", lambda *_: (4, []))
    result = SMALL.run("00000", tmp_path)
    assert result.problems == (f"{members[1]}: FloatingPointError: the physics diverged",)
    assert result.counts["simulated seconds"] == 4


def test_poses_that_are_not_the_same_bits_are_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a pipeline that remembers a number of the last frame that it saw."""
    seen: list[Any] = []

    def bits(pipeline: str, frame: int) -> bytes:
        seen.append((pipeline, frame))
        return f"{pipeline} {frame} {len(seen) if frame == 1 and pipeline == 'b' else 0}".encode()

    monkeypatch.setattr(shared_pipelines, "_scenes", lambda part, *_: (part, range(4)))
    monkeypatch.setattr(shared_pipelines, "_bits", bits)
    frames, different = shared_pipelines.differences(("a", "b"), (1, 1), 0, 4)
    assert different == ["b, frame 1: other poses"]
    assert frames == 8
    assert sorted(seen[:8]) == [*(("a", k) for k in (0, 0, 1, 1, 2, 3)), ("b", 0), ("b", 1)]


def test_the_first_difference_is_named() -> None:
    assert DEEDS.difference(DEEDS) == ""
    assert DEEDS.difference(replace(DEEDS, digests=("a", "x", "y"))) == "differs from reset or decision 1 on"
    shorter = replace(DEEDS, digests=("a", "b"), error="KeyError: 3")
    assert DEEDS.difference(shorter) == "differs from reset or decision 2 on; ended by KeyError: 3"


def test_growth_over_the_limit_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    soak = replace(SMALL, alone=1)
    for grown, problems in ((99.0, ()), (101.0, ("101 MB more in the second half, 100 MB is the limit",))):
        found = [(0, ([DEEDS, DEEDS], grown)), (1, [DEEDS]), (2, (4, []))]
        monkeypatch.setattr(load, "map_indices", lambda *_, found=found, **__: found)
        assert soak.run("00000", tmp_path).problems == problems


def test_a_process_that_ends_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*_: Any, **__: Any) -> Iterator[Any]:
        raise WorkerError("a worker was killed")

    monkeypatch.setattr(load, "map_indices", killed)
    assert SMALL.run("00000", tmp_path).problems == ("a worker was killed",)


def test_units_are_whole_and_take_all_parts_and_members_in_turn() -> None:
    soak = LoadSoak()
    assert len(soak.units()) == 45  # 24 hours: 16 environments of 2 minutes each
    assert LoadSoak(seconds=1).units() == soak.units()[:1]
    assert LoadSoak(seconds=1).settings() == soak.settings()
    assert {member.part for k in range(2) for member in soak.members(k)} == set(soak.parts)
    assert sum(member.perception == "learned" for member in soak.members(3)) == 2
    assert soak.members(3) == soak.members(3)
    assert soak.members(3) != soak.members(4)
    assert sorted(k for unit in range(4) for k in soak.chosen(unit)) == list(range(16))


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match="seconds and chunk must be at least 1, got 0 and 120"):
        LoadSoak(seconds=0)
