"""Selectors on rows made by hand, and on whole bins: as pickers, and in the environment, they do the same."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.oracle import PoseNoise
from policies.grasping.clearance import RankSettings
from policies.grasping.outcomes import Abstention, GraspOutcome, PickResult
from policies.picking.episode import Termination, run_bin
from policies.picking.scripted import ScriptedPicker
from policies.selection.candidate_generator import ROWS, GraspCandidates, Observation
from policies.selection.env import GraspSelectionEnv
from policies.selection.features import FEATURES, RANKED, column
from policies.selection.selectors import (
    SELECTORS,
    BestScoreSelector,
    HighestSelector,
    RandomSelector,
    Selector,
    SelectorPicker,
    WeightedSelector,
    load_selector,
    run_selector,
)
from tests.policies.hand_cell import Shifted, decision
from tests.policies.selection_cell import SMALL

RNG = np.random.default_rng(0)


def rows(count: int, **columns: list[float]) -> Observation:
    """Return an observation of ``count`` grasps; features that are not given are 0."""
    grasps = np.zeros((ROWS, len(FEATURES)), dtype=np.float32)
    for name, values in columns.items():
        grasps[:count, column(name)] = values
    return {"grasps": grasps, "mask": (np.arange(ROWS) < count).astype(np.int8)}


def closed(observation: Observation, *closing: int) -> Observation:
    mask = observation["mask"].copy()
    mask[list(closing)] = 0
    return observation | {"mask": mask}


# --- rows made by hand -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("selector", "name"), [(HighestSelector(), "top"), (BestScoreSelector(), "score")])
def test_the_largest_of_one_feature_wins_and_the_first_of_equals(selector: Selector, name: str) -> None:
    observation = rows(4, **{name: [0.2, 0.7, 0.7, 0.1]})
    assert selector.select(observation, RNG) == 1
    assert selector.select(closed(observation, 1), RNG) == 2
    assert selector.select(closed(observation, 1, 2), RNG) == 0


def test_rows_that_hold_nothing_are_never_chosen() -> None:
    low = rows(2, rank=[-0.5, -0.2], covered=[1.0, 1.0], buried=[1.0, 1.0])  # worth less than an empty row's 0
    assert WeightedSelector().select(low, RNG) == 0
    assert {RandomSelector().select(low, RNG) for _ in range(50)} == {0, 1}


def test_a_random_choice_is_even() -> None:
    observation, rng = closed(rows(5), 1), np.random.default_rng(1)
    drawn = np.bincount([RandomSelector().select(observation, rng) for _ in range(4000)], minlength=5)
    np.testing.assert_allclose(drawn / 4000, [0.25, 0, 0.25, 0.25, 0.25], atol=0.03)


@pytest.mark.parametrize("name", RANKED)
def test_each_ranked_feature_has_its_weight(name: str) -> None:
    """Against the first row, which has half of everything, more of a good feature wins and more of a bad one loses."""
    less_wanted = name in ("covered", "buried")
    half = {other: [0.5, 0.5] for other in RANKED}
    assert WeightedSelector().select(rows(2, **half | {name: [0.5, 0.6]}), RNG) == (0 if less_wanted else 1)
    assert WeightedSelector().select(rows(2, **half | {name: [0.5, 0.4]}), RNG) == (1 if less_wanted else 0)
    weight = f"penalty_{name}" if less_wanted else f"weight_{name}"
    indifferent = WeightedSelector(replace(RankSettings(), **{weight: 0.0}))
    assert indifferent.select(rows(2, **half | {name: [0.5, 0.0 if less_wanted else 1.0]}), RNG) == 0


def test_a_suspect_part_comes_last_whatever_its_worth() -> None:
    observation = rows(3, quality=[1.0, 0.1, 0.2], suspect=[1.0, 0.0, 0.0])
    assert WeightedSelector().select(observation, RNG) == 2
    assert WeightedSelector().select(closed(observation, 1, 2), RNG) == 0


def test_selectors_have_names() -> None:
    for name, kind in SELECTORS.items():
        assert type(load_selector(name)) is kind
    with pytest.raises(ValueError, match=r"one of random, highest, best_score, weighted, .*, got 'best'"):
        load_selector("best")


def test_candidates_without_their_last_row_have_a_reason() -> None:
    mask = np.arange(ROWS) < 2
    one = GraspCandidates(rows=np.ones((ROWS, len(FEATURES)), np.float32), mask=mask, reason=None).without(0)
    assert (one.valid, one.reason, bool(one)) == ([1], None, True)
    assert not one.rows[0].any()
    none = one.without(1)
    assert (none.valid, none.reason, bool(none)) == ([], Abstention.NO_CLEAR_APPROACH, False)
    assert mask.sum() == 2  # the first candidates are as they were


# --- whole bins ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def env() -> Iterator[GraspSelectionEnv]:
    # The noise makes some attempts fail, which the picker remembers.
    noise = PoseNoise(translation=0.008)
    env = GraspSelectionEnv(**SMALL | {"num_parts": (2, 4)}, pose_noise=noise)
    yield env
    env.close()


def played(env: GraspSelectionEnv, selector: Selector, seed: int) -> tuple[list[PickResult], str, list[str]]:
    """Play an episode by hand; return its attempts, how it ended, and how each step came out."""
    observation, _ = env.reset(seed=seed)
    attempts, outcomes, over, info = [], [], False, {"termination": ""}
    while not over:
        row = selector.select(observation, RNG)
        observation, _, terminated, truncated, info = env.step(np.int64(row))
        outcomes.append(info["outcome"])
        attempts += [env.result] if env.result is not None else []
        over = terminated or truncated
    return attempts, info["termination"], outcomes


class Shuffled:
    """Shows another selector the rows in another order."""

    def __init__(self, inner: Selector) -> None:
        self._inner = inner
        self._rng = np.random.default_rng(7)

    def select(self, observation: Observation, rng: np.random.Generator) -> int:
        order = self._rng.permutation(ROWS)
        return int(order[self._inner.select({key: value[order] for key, value in observation.items()}, rng)])


@pytest.mark.slow
def test_the_weighted_score_picks_as_the_scripted_picker_does(env: GraspSelectionEnv) -> None:
    """Bit for bit over a bin with failures, from the features alone: whatever the order of the rows."""
    seed = 54  # parts are delivered after a miss; the part of a miss would come first
    scripted = run_bin(env.cell, ScriptedPicker(env.cell), seed)
    expected = [decision(pick) for pick in scripted.picks]
    assert len(expected) >= 3
    assert any(not pick.success for pick in scripted.attempts)
    for selector in (WeightedSelector(), Shuffled(WeightedSelector())):
        weighted = run_selector(env, selector, seed)
        assert [decision(pick) for pick in weighted.picks] == expected
        assert (weighted.termination, weighted.delivered) == (scripted.termination, scripted.delivered)


@pytest.mark.slow
def test_an_episode_and_a_bin_are_the_same(env: GraspSelectionEnv) -> None:
    selector = load_selector("highest")
    as_bin = run_selector(env, selector, 33)
    attempts, termination, outcomes = played(env, selector, 33)
    assert [decision(pick) for pick in as_bin.attempts] == [decision(pick) for pick in attempts]
    assert [str(pick.outcome) for pick in as_bin.attempts] == [o for o in outcomes if o != "no_clear_approach"]
    assert as_bin.termination == termination


@pytest.mark.slow
def test_a_random_bin_depends_on_its_seed_alone(env: GraspSelectionEnv) -> None:
    def choices(seed: int) -> list[Any]:
        picker = SelectorPicker(env.cell, RandomSelector(), env.picker)
        env.cell.reset(seed=seed, options={"num_parts": 3})
        picker.reset()
        return [decision(picker.pick()) for _ in range(2)]

    first = choices(34)
    choices(35)
    assert choices(34) == first


def test_failures_end_a_selectors_bin_as_the_environment_says(
    env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(env, "max_failures", 1)
    monkeypatch.setattr(env.cell, "_num_parts", (1, 1))
    monkeypatch.setattr(env.cell, "_perceiver", Shifted((0.0, 0.0, 0.1)))  # said to hover: the jaw closes on air
    seen: list[PickResult] = []
    result = run_selector(env, HighestSelector(), 31, seen.append)
    assert [pick.outcome for pick in result.picks] == [GraspOutcome.MISSED]
    assert result.termination is Termination.TWO_FAILURES
    assert tuple(seen) == result.picks


class Nothing:
    """Sees nothing."""

    def perceive(self, *_: object, likely: bool = False) -> ObservedCandidates:
        return ObservedCandidates()


def test_no_candidate_is_an_abstention_for_its_reason(env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    env.cell.reset(seed=31, options={"num_parts": 1})
    picker = SelectorPicker(env.cell, HighestSelector(), env.picker)
    with monkeypatch.context() as patch:
        patch.setattr(env.picker, "plan", lambda grasp: Abstention.NO_CLEAR_APPROACH)
        blocked = picker.pick()
    assert (blocked.abstention, blocked.t_sense) == (Abstention.NO_CLEAR_APPROACH, 0.5)
    monkeypatch.setattr(env.cell, "_perceiver", Nothing())
    result = run_selector(env, HighestSelector(), 31)
    assert [pick.abstention for pick in result.picks] == [Abstention.NO_CANDIDATE] * 2
    assert result.termination is Termination.ABSTAINED


def test_a_selector_that_chooses_an_empty_row_is_refused(env: GraspSelectionEnv) -> None:
    class Stubborn:
        def select(self, observation: Observation, rng: np.random.Generator) -> int:
            return ROWS - 1

    env.cell.reset(seed=31, options={"num_parts": 1})
    picker = SelectorPicker(env.cell, Stubborn(), env.picker)
    with pytest.raises(ValueError, match=r"the selector chose row 31, but only \[0, 1, 2\] hold a grasp"):
        picker.pick()
