"""The search within one group: poses on a line whose logits are given, and a scorer that notes what it is asked."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from perception.geometry import Floats, make_transform
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.group_search import GroupSearch
from perception.pose.hypothesis_scoring import RoughHypothesis, ScoredHypothesis
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.verification.verification import Verdict

CONFIG = EstimatorConfig(hypotheses=2, most_hypotheses=5, sure=0.9, finalists=1)
NOTHING = Verdict(edge_score=0.0, explained=0.0, support=0.0, violation=0.0, measured=0.0, logit=0.0)


def place(T: Floats) -> float:
    return float(T[0, 3])


def poses(*places: float) -> Floats:
    return np.array([make_transform(translation=[x, 0.0, 0.0]) for x in places])


class Scorer:
    """Coarse refinement keeps a pose, full refinement moves it by 0.5; ``logits`` are by place, 0 elsewhere."""

    def __init__(
        self,
        logits: dict[float, float],
        near: dict[float, Sequence[float]] | None = None,
        promises: dict[float, float] | None = None,
    ) -> None:
        self.logits = logits
        self.promises = promises or {}
        self.near = near or {}
        self.asked: list[tuple[str, float]] = []
        self.estimated = 0

    def scored(self, x: float, final: bool) -> ScoredHypothesis:
        (T,) = poses(x)
        return ScoredHypothesis(T_cam_part=T, verdict=replace(NOTHING, logit=self.logits.get(x, 0.0)), final=final)

    def refine_roughly(self, T: Floats) -> RoughHypothesis:
        return RoughHypothesis(T_cam_part=T, promise=self.promises.get(place(T), 0.0))

    def refine_coarsely(self, T: Floats) -> ScoredHypothesis:
        self.asked.append(("coarse", place(T)))
        return self.scored(place(T), final=False)

    def refine_fully(self, T: Floats) -> ScoredHypothesis:
        self.asked.append(("full", place(T)))
        return self.scored(place(T) + 0.5, final=True)

    def near_symmetric(self, hypothesis: ScoredHypothesis) -> list[ScoredHypothesis]:
        return [self.scored(x, final=False) for x in self.near.get(place(hypothesis.T_cam_part), ())]

    def score_drop(self, hypothesis: ScoredHypothesis) -> float:
        self.asked.append(("drop", place(hypothesis.T_cam_part)))
        return 1.0

    def estimate(
        self, best: ScoredHypothesis, rivals: Sequence[ScoredHypothesis], drop: float, instance_idx: int
    ) -> PoseEstimate:
        self.estimated += 1
        return PoseEstimate(
            T_cam_part=best.T_cam_part,
            score=1 / (1 + len(rivals)),
            instance_idx=instance_idx,
            visible_fraction=0.0,
            verdict=best.verdict,
            margin=0.0,
            score_drop=drop,
            size=0,
            surface_score=1.0,
        )


def searching(scorer: Scorer, *places: float, config: EstimatorConfig = CONFIG, most: float = np.inf) -> GroupSearch:
    """Return a search that has tried poses; those beyond ``most`` are impossible."""
    search = GroupSearch(scorer, config, lambda T: 0.0 if place(T) <= most else np.inf, 7)  # type: ignore[arg-type]
    search.add(poses(*places))
    return search


def best_place(search: GroupSearch) -> float | None:
    found = search.best()
    assert found is None or (found.instance_idx, found.score_drop) == (7, 1.0)
    return None if found is None else place(found.T_cam_part)


@pytest.mark.parametrize(("logit", "tried"), [(2.1, 5), (2.3, 3)])  # logistic function: 0.89 and 0.91
def test_hypotheses_are_tried_until_one_is_good_enough(logit: float, tried: int) -> None:
    scorer = Scorer({2.0: logit})
    searching(scorer, 0.0, 1.0, 2.0, 3.0, 4.0)
    assert scorer.asked == [("coarse", float(x)) for x in range(tried)]


def test_the_most_promising_hypotheses_are_tried_first_and_the_others_not_at_all() -> None:
    scorer = Scorer({}, promises={6.0: 3.0, 3.0: 2.0, 1.0: 1.0, 7.0: -1.0})
    searching(scorer, *range(8))
    assert scorer.asked == [("coarse", x) for x in (6.0, 3.0, 1.0, 0.0, 2.0)]  # equally promising ones by their votes


@pytest.mark.parametrize(("logit", "refined"), [(1.1, True), (0.9, False)])
def test_a_finalist_far_behind_the_best_is_not_refined_fully(logit: float, refined: bool) -> None:
    scorer = Scorer({0.0: 3.0, 0.5: 3.0, 1.0: logit, 1.5: 9.0})
    search = searching(scorer, 0.0, 1.0, config=replace(CONFIG, finalists=2, contending=2.0))
    assert best_place(search) == (1.5 if refined else 0.5)
    assert (("full", 1.0) in scorer.asked) == refined


def test_impossible_hypotheses_are_dropped_and_do_not_count() -> None:
    scorer = Scorer({5.0: 9.0, 0.0: 3.0})
    assert best_place(searching(scorer, 5.0, 6.0, 0.0, 1.0, 2.0, most=4.0)) == 0.0  # refined fully it is worse
    assert ("coarse", 1.0) in scorer.asked
    assert ("coarse", 2.0) not in scorer.asked  # two possible ones, of which one is good enough


@pytest.mark.parametrize(("fine", "expected"), [(4.0, 1.5), (3.0, 1.5), (2.9, 1.0)])
def test_the_full_refinement_is_kept_unless_it_is_worse(fine: float, expected: float) -> None:
    assert best_place(searching(Scorer({1.0: 3.0, 1.5: fine}), 0.0, 1.0)) == expected


def test_a_full_refinement_to_an_impossible_pose_is_not_kept() -> None:
    assert best_place(searching(Scorer({1.0: 3.0, 1.5: 9.0}), 0.0, 1.0, most=1.2)) == 1.0


def test_only_the_finalists_are_refined_fully_and_only_once() -> None:
    scorer = Scorer({0.0: 1.0, 1.0: 3.0, 2.0: 2.0})
    search = searching(scorer, 0.0, 1.0, 2.0, config=replace(CONFIG, finalists=2, sure=1.0))
    for _ in range(2):
        assert best_place(search) == 1.0
        assert scorer.asked[3:] == [("full", 1.0), ("full", 2.0), ("drop", 1.0)]


def test_an_estimate_is_made_anew_only_when_a_hypothesis_came_or_went() -> None:
    scorer = Scorer({0.0: 1.0, 1.0: 3.0, 2.0: 2.0})
    search = searching(scorer, 0.0, 1.0, 2.0, config=replace(CONFIG, sure=1.0))
    first = search.best()
    assert not search.rule_out(lambda T: place(T) > 9)
    assert search.best() is first
    assert search.rule_out(lambda T: place(T) == 2.0)
    fewer = search.best()
    assert (fewer.score if fewer else 0) == 1 / 2  # one rival is left
    search.add(poses(4.0))
    again = search.best()
    assert (again.score if again else 0) == 1 / 3
    assert scorer.estimated == 3


def test_the_next_best_takes_the_place_of_one_that_is_ruled_out() -> None:
    scorer = Scorer({0.0: 1.0, 1.0: 3.0, 2.0: 2.0})
    search = searching(scorer, 0.0, 1.0, 2.0, config=replace(CONFIG, sure=1.0))
    assert best_place(search) == 1.0
    assert not search.rule_out(lambda T: place(T) > 5)
    assert search.rule_out(lambda T: place(T) == 1.0)
    found = search.best()
    assert found is not None
    assert (place(found.T_cam_part), found.score) == (2.0, 0.5)  # one rival is left
    assert search.rule_out(lambda T: True)
    assert search.best() is None


def test_a_near_symmetric_pose_may_be_the_better_one_unless_it_is_ruled_out() -> None:
    logits, near = {1.0: 3.0, 8.0: 4.0}, {1.0: (8.0,)}
    assert best_place(searching(Scorer(logits, near), 0.0, 1.0)) == 8.0
    ruled_out = searching(Scorer(logits, near), 0.0, 1.0)
    assert not ruled_out.rule_out(lambda T: place(T) == 8.0)
    assert best_place(ruled_out) == 1.0
    assert best_place(searching(Scorer(logits, near), 0.0, 1.0, most=7.0)) == 1.0


def test_nothing_is_found_among_no_hypotheses() -> None:
    assert best_place(searching(Scorer({}))) is None


def test_an_impossible_hypothesis_is_missed_if_it_is_the_best() -> None:
    missed = searching(Scorer({5.0: 9.0, 6.0: 2.0, 0.0: 3.0}), 5.0, 6.0, 0.0, most=4.0).missed
    assert missed is not None
    assert (place(missed.T_cam_part), missed.logit) == (5.0, 9.0)
    assert searching(Scorer({5.0: 3.0, 0.0: 3.0}), 5.0, 0.0, most=4.0).missed is None
    assert searching(Scorer({0.0: 3.0}), 0.0, 1.0).missed is None
    only = searching(Scorer({}), 5.0, most=4.0)
    assert only.missed is not None
    assert only.best() is None


def test_a_sure_hypothesis_with_a_penalty_ends_no_search() -> None:
    scorer = Scorer({2.0: 2.3})
    search = GroupSearch(scorer, CONFIG, lambda T: 0.1 if place(T) == 2.0 else 0.0, 7)  # type: ignore[arg-type]
    search.add(poses(0.0, 1.0, 2.0, 3.0, 4.0))
    assert scorer.asked == [("coarse", float(x)) for x in range(5)]
