"""What a selector learns from: the cells it is tried in, and logged attempts with what came of them."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from binpick_env.config import BinConfig, CameraConfig, CellConfig, Perception, SensorPreset
from binpick_env.jobs.process_map import map_indices
from perception.runtime.files import json_text, replace_atomically
from policies.grasping.outcomes import PickResult
from policies.selection.candidate_generator import Observation
from policies.selection.env import GraspSelectionEnv
from policies.selection.selectors import load_selector


@dataclass(frozen=True, kw_only=True)
class Cells:
    """The bins that experience is gathered in."""

    part: str = "tee"  # catalogue name, or path to an STL, OBJ or PLY file
    min_parts: int = 20  # smallest fill of a bin
    max_parts: int = 30  # largest fill
    perception: Perception = "oracle"  # learned for the last stretch of a training
    pose_noise: Literal["learned"] | None = None  # the oracle's: errors such as the learned perceiver's, or none
    sensor: SensorPreset = "good"  # the depth camera's noise
    fast: bool = False  # leave out the physics of an arm that touches nothing
    max_failures: int = 2  # in a row, that end a bin
    bin: tuple[float, float, float] | None = None  # length, width, height inside [m]; None is the standard bin
    hand_eye: float = 0.0  # error of the camera's reported place, standard deviation an axis [m]

    def environment(self) -> GraspSelectionEnv:
        """Build one; it casts rays on one thread."""
        values = asdict(self)
        num_parts = values.pop("min_parts"), values.pop("max_parts")
        size = values.pop("bin")
        config = None if size is None else CellConfig(bin=BinConfig(inner_size=size))
        camera = CameraConfig(hand_eye=values.pop("hand_eye"))
        return GraspSelectionEnv(**values, num_parts=num_parts, config=config, camera=camera, threads=1)

    def plain(self) -> dict[str, Any]:
        """Return the values as they are noted, and as JSON gives them back."""
        values: dict[str, Any] = json.loads(json_text(asdict(self)))
        return values


@dataclass(frozen=True, eq=False, kw_only=True)
class Attempts:
    """Logged attempts (N,) with all that was on offer.

    Attributes:
        grasps: (N, K, F) float32 rows.
        mask: (N, K) int8.
        chosen: (N,) row.
        delivered: (N,) bool.
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
        """Read bins' files, one after the other.

        Raises:
            ValueError: They hold no attempt.
        """
        columns: dict[str, list[NDArray[Any]]] = {name: [] for name in cls.__dataclass_fields__}
        for path in paths:
            with np.load(path, allow_pickle=False) as file:
                for name, column in columns.items():
                    column.append(file[name])
        if not sum(len(column) for column in columns["chosen"]):
            raise ValueError(f"{len(paths)} bins hold no attempt")
        return cls(**{name: np.concatenate(column) for name, column in columns.items()})


@dataclass(frozen=True, kw_only=True)
class Behaviour:
    """Who chooses while experience is gathered."""

    selector: str = "weighted"  # a heuristic, or a trained selector
    epsilon: float = 0.3  # share of the choices that are made at random instead
    tries: int = 1  # attempts from each state; all but the one that is chosen are drawn at random, and undone

    def __post_init__(self) -> None:
        if not 0 <= self.epsilon <= 1:
            raise ValueError(f"epsilon must be in [0, 1], got {self.epsilon}")
        if self.tries < 1:
            raise ValueError(f"tries must be at least 1, got {self.tries}")


def gather(
    cells: Cells, behaviour: Behaviour, out: Path, bins: Sequence[int], seed: int, workers: int = 1
) -> Iterator[int]:
    """Log the attempts in bins, one file each; yield the index of each as it is there. What is there already stays.

    Args:
        cells: What is picked.
        behaviour: Who chooses.
        out: Folder of the files.
        bins: Indices.
        seed: Bin i has numpy's SeedSequence over (seed, i).
        workers: Processes.
    """
    missing = [index for index in bins if not bin_file(out, index).exists()]
    yield from (index for index in bins if index not in missing)
    yield from map_indices(partial(log_bin, cells, behaviour, out, seed), missing, workers)


def bin_file(out: Path, index: int) -> Path:
    """Return where the attempts of a bin are kept."""
    return out / f"attempts_{index:05d}.npz"


_environments: dict[Cells, GraspSelectionEnv] = {}  # of this process: to build one takes seconds


def log_bin(cells: Cells, behaviour: Behaviour, out: Path, seed: int, index: int) -> int:
    """Pick one bin and keep its attempts; return its index."""
    if cells not in _environments:
        _environments[cells] = cells.environment()
    env, selector = _environments[cells], load_selector(behaviour.selector)
    bin_seed = np.random.SeedSequence([seed, index]).generate_state(1)[0]
    rng = np.random.default_rng([seed, index, 1])
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
    _save(bin_file(out, index), rows, env)
    return index


def _probed(
    env: GraspSelectionEnv, observation: Observation, chosen: int, count: int, rng: np.random.Generator
) -> list[tuple[int, bool]]:
    """Attempt up to ``count`` other rows from this state; return each with whether it delivered."""
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

    def write(draft: Path) -> None:
        with draft.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **columns)

    replace_atomically(path, write)
