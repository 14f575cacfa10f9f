"""The experience that a selector learns from: simulated cells, and a log of attempts with their outcomes."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from binpick_env.config import Perception
from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Workers
from binpick_env.options import CellOptions
from perception.runtime.file_work import FolderWork
from perception.runtime.files import json_text, write_atomically
from perception.runtime.records import RecordFormat
from policies.grasping.outcomes import PickResult
from policies.selection.candidate_generator import Observation
from policies.selection.env import GraspSelectionEnv
from policies.selection.selectors import load_selector

CONFIG = "experience.json"
FORMAT = RecordFormat(kind="bin of attempts", version=1, remedy="delete it, and train_selector bandit makes it again")


@dataclass(frozen=True, kw_only=True)
class Cells(CellOptions):
    """The bins that experience is gathered in."""

    min_parts: int = 20  # smallest number of parts in a bin
    max_parts: int = 30  # largest number of parts in a bin
    perception: Perception = "oracle"  # source of the poses; "learned" for the last stretch of a training
    pose_noise: Literal["learned"] | None = None  # "learned": the oracle errs as the learned perceiver does
    fast: bool = False  # leave out the physics of an arm that touches nothing
    max_failures: int = 2  # consecutive failures that end a bin

    def environment(self) -> GraspSelectionEnv:
        """Build an environment that casts rays on one thread."""
        return GraspSelectionEnv(
            self.part,
            unit=self.unit,
            symmetry=self.symmetry,
            density=self.density,
            symmetry_tolerance=self.symmetry_tolerance,
            num_parts=(self.min_parts, self.max_parts),
            perception=self.perception,
            sensor=self.sensor,
            pose_noise=self.pose_noise,
            config=self.cell(),
            threads=1,
            max_failures=self.max_failures,
            fast=self.fast,
        )

    def plain(self) -> dict[str, Any]:
        """Return the values as they are written to files, in the types that JSON gives back."""
        # hand_eye [m] is the former name of hand_eye_mm; both are written until the next minor version.
        values = {**asdict(self), "hand_eye": self.hand_eye_mm / 1000}
        read: dict[str, Any] = json.loads(json_text(values))
        return read

    @classmethod
    def upgraded(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return what any version's :meth:`plain` wrote as this version writes it; new settings take their defaults."""
        hand_eye_mm = values.get("hand_eye_mm", round(1000 * values.get("hand_eye", 0.0), 9))
        return {**cls().plain(), **values, "hand_eye_mm": hand_eye_mm, "hand_eye": hand_eye_mm / 1000}


@dataclass(frozen=True, kw_only=True)
class Behaviour:
    """The behaviour policy: how grasps are chosen while attempts are logged."""

    selector: str = "weighted"  # name of a heuristic, or of or path to a trained selector
    epsilon: float = 0.3  # share of the choices that are made at random instead
    tries: int = 1  # attempts from each state; all but the chosen one are drawn at random and undone

    def __post_init__(self) -> None:
        if not 0 <= self.epsilon <= 1:
            raise ValueError(f"epsilon must be in [0, 1], got {self.epsilon}")
        if self.tries < 1:
            raise ValueError(f"tries must be at least 1, got {self.tries}")


@dataclass(frozen=True, eq=False, kw_only=True)
class Attempts:
    """Logged attempts (N,), each with all grasp candidates that could have been chosen.

    Attributes:
        grasps: (N, K, F) float32 features of the candidates.
        mask: (N, K) int8, 1 for rows that hold a candidate.
        chosen: (N,) row of the candidate that was attempted.
        delivered: (N,) bool, whether the attempt delivered its part.
        bins: (N,) index of the bin.
        states: (N,) number of the decision in its bin; attempts from one state share it.
    """

    grasps: NDArray[np.float32]
    mask: NDArray[np.int8]
    chosen: NDArray[np.int64]
    delivered: NDArray[np.bool_]
    bins: NDArray[np.int64]
    states: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.chosen)

    @classmethod
    def load(cls, paths: Sequence[Path]) -> "Attempts":
        """Read the files of bins and join them in their order.

        Raises:
            RecordError: A file is damaged.
            ValueError: The files hold no attempt.
        """
        columns: dict[str, list[NDArray[Any]]] = {name: [] for name in cls.__dataclass_fields__}
        for path in paths:
            stored = FORMAT.load_arrays(path, lambda arrays: {name: arrays[name] for name in columns})
            for name, column in columns.items():
                column.append(stored[name])
        if not sum(len(column) for column in columns["chosen"]):
            raise ValueError(f"{len(paths)} bins hold no attempt")
        return cls(**{name: np.concatenate(column) for name, column in columns.items()})


class ExperienceError(ValueError):
    """The folder holds attempts from other bins or under another behaviour policy."""


@dataclass(frozen=True, kw_only=True)
class AttemptLog:
    """A folder of logged attempts, one file per bin.

    Bin i is reset with numpy's ``SeedSequence`` over (seed, i), so that its attempts depend on neither the number of
    bins nor the number of processes.
    """

    folder: Path  # created with the first bin
    cells: Cells  # bins that are picked
    behaviour: Behaviour  # how grasps are chosen
    seed: int  # seed of piles and exploration

    def plain(self) -> dict[str, Any]:
        """Return cells, behaviour and seed as they are written to files."""
        return {"cells": self.cells.plain(), "behaviour": asdict(self.behaviour), "seed": self.seed}

    def file(self, index: int) -> Path:
        """Return the path of the attempts in bin ``index``."""
        return self.folder / f"attempts_{index:05d}.npz"

    def claim(self) -> None:
        """Write what the attempts depend on into the folder.

        Raises:
            ExperienceError: The folder holds attempts from other bins or under another behaviour policy.
        """
        path = self.folder / CONFIG
        if path.exists():
            noted = json.loads(path.read_text(encoding="utf-8"))
            if {**noted, "cells": Cells.upgraded(noted["cells"])} != self.plain():
                raise ExperienceError(f"{self.folder} holds attempts in other bins; choose another folder with --out")
        write_atomically(path, json_text(self.plain()))

    def fill(self, bins: Sequence[int], workers: Workers = 1) -> Iterator[int]:
        """Log the attempts in bins and yield the index of each as it is complete; files that exist are kept.

        Args:
            bins: Indices of the bins.
            workers: Number of processes, or a cluster.
        """
        missing = [index for index in bins if not self.file(index).exists()]
        yield from (index for index in bins if index not in missing)
        yield from map_indices(FolderWork(partial(_log_bin_in, self), self.folder), missing, workers)

    def attempts(self, bins: Sequence[int]) -> Attempts:
        """Read the attempts in bins that have been logged."""
        return Attempts.load([self.file(index) for index in bins])


_environments: dict[Cells, GraspSelectionEnv] = {}  # the last one of this process: to build one takes seconds


def log_bin(log: AttemptLog, index: int) -> int:
    """Pick bin ``index``, write its attempts and return the index."""
    cells, behaviour = log.cells, log.behaviour
    env, selector = _environment(cells), load_selector(behaviour.selector)
    bin_seed = np.random.SeedSequence([log.seed, index]).generate_state(1)[0]
    rng = np.random.default_rng([log.seed, index, 1])
    observation, _ = env.reset(seed=int(bin_seed))
    rows: list[dict[str, Any]] = []
    over, state = not observation["mask"].any(), 0
    while not over:
        explores = rng.random() < behaviour.epsilon
        row = rng.choice(np.flatnonzero(observation["mask"])) if explores else selector.select(observation, rng)
        made = _probed(env, observation, row, behaviour.tries - 1, rng) if behaviour.tries > 1 else []
        after, _, terminated, truncated, _ = env.step(np.int64(row))
        if env.result is not None:
            made.append((int(row), env.result.success))
        rows += [
            {**observation, "chosen": tried, "delivered": success, "bins": index, "states": state}
            for tried, success in made
        ]
        state += 1
        observation, over = after, terminated or truncated
    _save(log.file(index), rows, env)
    return index


def _log_bin_in(log: AttemptLog, folder: Path, index: int) -> int:
    return log_bin(replace(log, folder=folder), index)


def _environment(cells: Cells) -> GraspSelectionEnv:
    """Return the environment of these cells; only that of the last cells is kept."""
    if cells not in _environments:
        for former in _environments.values():
            former.close()
        _environments.clear()  # before the next one is built: each holds hundreds of megabytes
        _environments[cells] = cells.environment()
    return _environments[cells]


def _probed(
    env: GraspSelectionEnv, observation: Observation, chosen: int, count: int, rng: np.random.Generator
) -> list[tuple[int, bool]]:
    """Attempt up to ``count`` rows other than ``chosen`` from this state; return each with whether it delivered."""
    others = np.setdiff1d(np.flatnonzero(observation["mask"]), [chosen])
    results = [(int(row), env.probe(np.int64(row))) for row in rng.permutation(others)[:count]]
    return [(row, result.success) for row, result in results if isinstance(result, PickResult)]


def _save(path: Path, rows: list[dict[str, Any]], env: GraspSelectionEnv) -> None:
    empty = {key: np.zeros((0, *(space.shape or ())), space.dtype) for key, space in env.observation_space.items()}  # type: ignore[attr-defined]
    columns = {key: np.stack([row[key] for row in rows]) if rows else array for key, array in empty.items()}
    columns |= {
        "chosen": np.array([row["chosen"] for row in rows], np.int64),
        "delivered": np.array([row["delivered"] for row in rows], np.bool_),
        "bins": np.array([row["bins"] for row in rows], np.int64),
        "states": np.array([row["states"] for row in rows], np.int64),
    }
    FORMAT.save_arrays(path, columns)
