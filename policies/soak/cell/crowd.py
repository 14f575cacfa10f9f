"""Environments that pick beside each other in one process, or alone, and what each did, to be compared bit by bit."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from binpick_env.config import Perception
from policies.selection.env import GraspSelectionEnv
from policies.soak.cell.memory import resident_mb
from policies.soak.cell.select import random_row

WIDTH, HEIGHT = 640, 480  # size of the images [px]


@dataclass(frozen=True, kw_only=True)
class Member:
    """An environment, and how long it picks.

    Attributes:
        part: Name of the part.
        seed: Seed of its piles and decisions.
        perception: What finds the parts in a frame.
        fast: Whether the arm moves kinematically where nothing else moves.
        num_parts: Smallest and largest number of parts in a pile.
        seconds: Simulated time after which it stops [s]; it makes at most one decision for each second.
    """

    part: str
    seed: int
    perception: Perception
    fast: bool
    num_parts: tuple[int, int]
    seconds: float

    def __str__(self) -> str:
        return f"{self.part}, {self.perception}, {'fast' if self.fast else 'full'}, seed {self.seed}"


@dataclass(frozen=True, kw_only=True)
class Deeds:
    """What a member did.

    Attributes:
        digests: One for each reset and decision, of all that was observed and of the state of the cell so far.
        seconds: Simulated time that passed in its decisions [s].
        decisions: Number of decisions.
        error: Exception that ended it; empty if none did.
    """

    digests: tuple[str, ...]
    seconds: float
    decisions: int
    error: str

    def difference(self, other: "Deeds") -> str:
        """Return where two members that should be equal part; empty where they never do."""
        if self == other:
            return ""
        same = zip(self.digests, other.digests, strict=False)
        first = next((k for k, (a, b) in enumerate(same) if a != b), min(len(self.digests), len(other.digests)))
        ends = "".join(f"; ended by {deeds.error}" for deeds in (self, other) if deeds.error)
        return f"differs from reset or decision {first} on{ends}"


class Picking:
    """One member at its work, a reset or a decision at a time."""

    def __init__(self, member: Member) -> None:
        """Build the environment."""
        self._member = member
        self._env = GraspSelectionEnv(
            part=member.part,
            num_parts=member.num_parts,
            perception=member.perception,
            fast=member.fast,
            width=WIDTH,
            height=HEIGHT,
        )
        self._rng = np.random.default_rng(member.seed)
        self._hash = hashlib.sha256()
        self._digests: list[str] = []
        self._seconds, self._decisions, self._error = 0.0, 0, ""
        self._over = True

    @property
    def share(self) -> float:
        """Share of its time that has passed; 1 once it stopped."""
        done = max(self._seconds, float(self._decisions)) / self._member.seconds
        return 1.0 if self._error else min(done, 1.0)

    @property
    def contact_memory(self) -> float:
        """Memory that MuJoCo has used for contacts and constraints at most, and keeps [MB]."""
        return float(self._env.cell.simulation.data.maxuse_arena) / 1024**2

    def go_on(self) -> None:
        """Drop a new pile if the last one is done with, and make a decision; note an exception."""
        try:
            if self._over:
                observation, _ = self._env.reset(seed=int(self._rng.integers(2**31)))
                self._note(observation, 0.0)
            before = self._env.cell.simulation.time
            observation, reward, ended, cut, _ = self._env.step(random_row(self._env, self._rng))
            self._note(observation, reward)
            self._over = ended or cut
            self._seconds += self._env.cell.simulation.time - before
            self._decisions += 1
        except Exception as error:  # whatever it is, it is what the soak test looks for
            self._error = f"{type(error).__name__}: {error}"

    def finish(self) -> Deeds:
        """Close the environment and return what was done."""
        with suppress(Exception):
            self._env.close()
        return Deeds(digests=tuple(self._digests), seconds=self._seconds, decisions=self._decisions, error=self._error)

    def _note(self, observation: Mapping[str, Any], reward: float) -> None:
        data = self._env.cell.simulation.data
        for values in (*observation.values(), reward, data.time, data.qpos, data.qvel):
            self._hash.update(np.ascontiguousarray(values).tobytes())
        self._digests.append(self._hash.hexdigest()[:16])


def pick_alone(member: Member) -> Deeds:
    """Return what a member does by itself."""
    picking = Picking(member)
    while picking.share < 1.0:
        picking.go_on()
    return picking.finish()


def pick_together(members: Sequence[Member], threads: int) -> tuple[list[Deeds], float]:
    """Return what each of several members does while all of them exist, in turns on several threads.

    Returns:
        The deeds, and by how much the memory grew in the second half, besides that for contacts, which grows with the
        pile that has most of them [MB].
    """
    crowd = [Picking(member) for member in members]
    halfway: float | None = None

    def used() -> float:
        return resident_mb() - sum(picking.contact_memory for picking in crowd)

    with ThreadPoolExecutor(threads) as pool:
        while todo := [picking for picking in crowd if picking.share < 1.0]:
            if halfway is None and all(picking.share >= 0.5 for picking in crowd):
                halfway = used()
            _all_done(pool, [picking.go_on for picking in todo])
    grown = used() - halfway if halfway is not None else 0.0
    return [picking.finish() for picking in crowd], grown


def _all_done(pool: ThreadPoolExecutor, works: Sequence[Callable[[], None]]) -> None:
    for future in [pool.submit(work) for work in works]:
        future.result()
