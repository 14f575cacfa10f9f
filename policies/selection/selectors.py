"""Selectors choose among grasp candidates: heuristics, trained networks, and a picker that asks either."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from binpick_env.env import BinPickEnv
from perception.geometry import Floats
from perception.runtime.job_files import local_file
from policies.grasping.clearance import RankSettings
from policies.grasping.outcomes import Abstention, PickResult
from policies.picking.episode import BinResult, run_bin
from policies.picking.plan import Plan
from policies.picking.scripted import T_SENSE, ScriptedPicker
from policies.selection.candidate_generator import PER_PART, GraspCandidates, Observation
from policies.selection.candidate_picker import CandidatePicker
from policies.selection.env import GraspSelectionEnv
from policies.selection.features import RANKED, column

SHIPPED = Path(__file__).resolve().parent / "shipped"
_TIE = 1e-5  # exceeds the rounding of a sum of float32 features; the first row wins a tie


class Selector(Protocol):
    """Chooses a row of an observation of ``BinPickSelect-v0``."""

    def select(self, observation: Observation, rng: np.random.Generator) -> int:
        """Return a row whose mask is 1.

        Args:
            observation: Features ``grasps`` (K, F) and ``mask`` (K,), which is 1 in at least one row.
            rng: Source of random choices.
        """
        ...


class RandomSelector:
    """Chooses uniformly among the candidates."""

    def select(self, observation: Observation, rng: np.random.Generator) -> int:
        """Draw a valid row."""
        return int(rng.choice(_valid(observation)))


class HighestSelector:
    """Chooses the part with the highest point."""

    def select(self, observation: Observation, rng: np.random.Generator) -> int:  # noqa: ARG002
        """Return the first row of that part."""
        return _first_best(observation, _column(observation, "top"))


class BestScoreSelector:
    """Chooses the part whose pose has the highest score; the oracle scores all parts alike."""

    def select(self, observation: Observation, rng: np.random.Generator) -> int:  # noqa: ARG002
        """Return the first row of that part."""
        return _first_best(observation, _column(observation, "score"))


class WeightedSelector:
    """Chooses by a weighted sum of features, as the scripted picker does; parts with a failed attempt come last."""

    def __init__(self, weights: RankSettings | None = None) -> None:
        """Keep the weights.

        Args:
            weights: Settings whose weights and penalties are used; the defaults if None.
        """
        self._weights = weights or RankSettings()

    def select(self, observation: Observation, rng: np.random.Generator) -> int:  # noqa: ARG002
        """Return the row with the largest sum."""
        total = np.zeros(len(observation["mask"]))
        for name in RANKED:
            sign, kind = (-1.0, "penalty") if name in ("covered", "buried") else (1.0, "weight")
            total += sign * getattr(self._weights, f"{kind}_{name}") * _column(observation, name)
        return _first_best(observation, total - 10.0 * _column(observation, "suspect"))


class LearnedSelector:
    """Chooses by a trained network: PPO's likeliest action, or the grasp that the bandit predicts to deliver."""

    def __init__(self, path: Path) -> None:
        """Load a ``.safetensors`` file.

        Raises:
            SelectorError: The file does not hold a whole selector that was trained on these features.
        """
        from policies.selection.weights import load_selector_net  # torch, which the heuristics do without

        self._network = load_selector_net(path)

    def select(self, observation: Observation, rng: np.random.Generator) -> int:  # noqa: ARG002
        """Return the row with the largest logit."""
        import torch

        with torch.no_grad():
            rows, mask = (torch.from_numpy(observation[key])[None] for key in ("grasps", "mask"))
            logits, _ = self._network(rows, mask)
        return _first_best(observation, logits[0].double().numpy())


SELECTORS: dict[str, Callable[[], Selector]] = {
    "random": RandomSelector,
    "highest": HighestSelector,
    "best_score": BestScoreSelector,
    "weighted": WeightedSelector,
}


def load_selector(spec: str) -> Selector:
    """Build the heuristic or load the trained selector that ``spec`` names.

    Args:
        spec: Name of a heuristic or of a shipped selector, or path to a ``.safetensors`` file.

    Raises:
        ValueError: There is no such selector.
    """
    if spec in SELECTORS:
        return SELECTORS[spec]()
    return LearnedSelector(selector_path(spec))


def selector_path(spec: str, *others: str) -> Path:
    """Return the path of a trained selector.

    Args:
        spec: Name of a shipped selector, or path to a ``.safetensors`` file.
        others: Further names that the caller accepts, for the error's text.

    Raises:
        ValueError: There is no such file; the text lists the known names.
    """
    for path in (Path(spec), SHIPPED / f"{spec}.safetensors"):
        if path.suffix == ".safetensors" and local_file(path).is_file():
            return path
    shipped = sorted(path.stem for path in SHIPPED.glob("*.safetensors"))
    known = ", ".join([*SELECTORS, *others, *shipped])
    raise ValueError(f"a selector must be one of {known}, or the path of a .safetensors file, got {spec!r}")


class SelectorPicker(CandidatePicker):
    """A `policies.picking.episode.Picker` whose grasps are chosen by a selector."""

    def __init__(
        self,
        env: BinPickEnv,
        selector: Selector,
        picker: ScriptedPicker | None = None,
        *,
        per_part: int = PER_PART,
    ) -> None:
        """Build the picker.

        Args:
            env: Unwrapped cell.
            selector: Selector that chooses among the candidates.
            picker: Picker that ranks, plans and executes; a new one if None.
            per_part: Largest number of candidates on one part.
        """
        super().__init__(env, picker, per_part)
        self._selector = selector
        self.reset()

    def reset(self) -> None:
        """Forget the last bin, and reseed the selector's random choices from the seed of the cell's reset alone."""
        super().reset()
        self._rng = np.random.default_rng([abs(self._env.np_random_seed or 0), 1])

    def pick(self) -> PickResult:
        """Make one decision on the last frame: an executed attempt, or an abstention."""
        candidates, generation_time = self._timed_candidates()
        started = time.perf_counter()
        plan = self._decide(candidates)
        compute = generation_time + time.perf_counter() - started
        if isinstance(plan, Abstention):
            return PickResult(abstention=plan, t_sense=T_SENSE, t_compute=compute, frame_id=self._env.frame_id)
        result = self._picker.execute(plan)
        return replace(result, t_compute=compute + result.t_compute)

    def _decide(self, candidates: GraspCandidates) -> Plan | Abstention:
        while candidates:
            row = self._selector.select(candidates.observation(), self._rng)
            if row not in candidates.valid:
                raise ValueError(f"the selector chose row {row}, but only {candidates.valid} hold a grasp")
            plan = self._picker.plan(candidates.grasps[row])
            if isinstance(plan, Plan):
                return plan
            candidates = candidates.without(row)
        assert candidates.reason is not None
        return candidates.reason


def run_selector(
    env: GraspSelectionEnv, selector: Selector, seed: int, on_pick: Callable[[PickResult], None] | None = None
) -> BinResult:
    """Play one episode of ``BinPickSelect-v0`` and return it as `policies.picking.episode.run_bin` does.

    Args:
        env: Unwrapped environment, whose cell is reset with ``seed``.
        selector: Selector that chooses among the candidates.
        seed: Seed of the pile, the sensor noise and the selector's random choices.
        on_pick: Callback with the result of each decision.
    """
    picker = SelectorPicker(env.cell, selector, env.picker, per_part=env.per_part)
    return run_bin(env.cell, picker, seed, on_pick, max_failures=env.max_failures)


def _valid(observation: Observation) -> NDArray[np.int64]:
    return np.flatnonzero(observation["mask"])


def _column(observation: Observation, name: str) -> Floats:
    return np.asarray(observation["grasps"][:, column(name)], dtype=np.float64)


def _first_best(observation: Observation, values: Floats) -> int:
    """Return the first valid row whose value ties with the largest of the (K,) values."""
    valid = _valid(observation)
    best = values[valid].max()
    return int(valid[np.argmax(values[valid] >= best - _TIE)])
