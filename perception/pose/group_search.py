"""The search for the pose of one group of boundary points."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from perception.geometry import Floats
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.hypothesis_scoring import HypothesisScorer, ScoredHypothesis
from perception.pose.pose_estimate import PoseEstimate

Condition = Callable[[Floats], bool]  # of a (4, 4) T_cam_part
Penalty = Callable[[Floats], float]  # of a (4, 4) T_cam_part; infinite for a pose that is impossible


class GroupSearch:
    """The hypotheses about one group of boundary points.

    `add` collects coarsely refined hypotheses. `best` refines the most promising ones fully and returns the best one.
    `rule_out` removes hypotheses that the pose of another group makes impossible; `best` then returns the next best.
    """

    def __init__(self, scorer: HypothesisScorer, config: EstimatorConfig, penalty: Penalty, instance_idx: int) -> None:
        """Start without any hypothesis.

        Args:
            scorer: Refines and scores hypotheses about the group.
            config: Numbers of hypotheses to try and to refine fully.
            penalty: What is taken off the logit of a pose; hypotheses for which it is infinite are dropped.
            instance_idx: Index of the group.
        """
        self._scorer = scorer
        self._config = config
        self._penalty = penalty
        self._instance_idx = instance_idx
        self._hypotheses: list[ScoredHypothesis] = []
        self._score_drops: dict[ScoredHypothesis, float] = {}  # of the best ones so far: each takes several verdicts
        self._ruled_out: list[Condition] = []
        self._best_impossible: ScoredHypothesis | None = None
        self._estimate: PoseEstimate | None = None  # of the best hypothesis among the present ones

    def add(self, poses: Floats) -> None:
        """Refine (C, 4, 4) poses roughly, then the most promising ones coarsely, and keep those that are possible."""
        config, self._estimate = self._config, None
        rough = [self._scorer.refine_roughly(T_cam_part) for T_cam_part in poses]
        for promising in sorted(rough, key=lambda each: -each.promise):
            if len(self._hypotheses) >= (config.hypotheses if self._is_sure() else config.most_hypotheses):
                break
            found = self._scorer.refine_coarsely(promising.T_cam_part)
            penalised = self._penalised(found)
            if penalised is not None:
                self._hypotheses.append(penalised)
            elif self._best_impossible is None or found.logit > self._best_impossible.logit:
                self._best_impossible = found

    def _is_sure(self) -> bool:
        """Return whether one of the hypotheses is good enough."""
        return any(found.verdict.score >= self._config.sure and not found.penalty for found in self._hypotheses)

    @property
    def missed(self) -> ScoredHypothesis | None:
        """The best impossible hypothesis, if none of those that are left is as good; only coarsely refined.

        It tells that the condition, such as the pose of the bin, may be wrong.
        """
        missed = self._best_impossible
        if missed is None or any(found.logit >= missed.logit for found in self._hypotheses):
            return None
        return missed

    def best(self) -> PoseEstimate | None:
        """Return the best pose that is not ruled out, None if there is none left.

        A later call refines only what an earlier one did not.
        """
        if not self._hypotheses:
            return None
        if self._estimate is not None:
            return self._estimate
        self._refine_finalists()
        best = self._hypotheses[0]
        if best not in self._score_drops:
            # Voting may have found one of two near-symmetric poses and missed the right one.
            similar = [self._allowed(found) for found in self._scorer.near_symmetric(best)]
            self._hypotheses += [found for found in similar if found is not None]
            self._refine_finalists()
            best = self._hypotheses[0]
            self._score_drops[best] = self._scorer.score_drop(best)
        drop = self._score_drops[best]
        self._estimate = self._scorer.estimate(best, self._hypotheses[1:], drop, self._instance_idx)
        return self._estimate

    def rule_out(self, impossible: Condition) -> bool:
        """Remove the hypotheses that meet a condition, also those found later; return whether any was removed."""
        self._ruled_out.append(impossible)
        count = len(self._hypotheses)
        self._hypotheses = [found for found in self._hypotheses if not impossible(found.T_cam_part)]
        if len(self._hypotheses) == count:
            return False
        self._estimate = None
        return True

    def _refine_finalists(self) -> None:
        """Refine the first ``finalists`` hypotheses fully, and sort all by their logit, best first."""
        self._sort()
        for k, coarse in enumerate(self._hypotheses[: self._config.finalists]):
            if not coarse.final and coarse.logit > self._hypotheses[0].logit - self._config.contending:
                fine = self._allowed(self._scorer.refine_fully(coarse.T_cam_part))
                if fine is None or fine.logit < coarse.logit:
                    fine = replace(coarse, final=True)
                self._hypotheses[k] = fine
        self._sort()

    def _sort(self) -> None:
        self._hypotheses.sort(key=lambda found: found.logit, reverse=True)

    def _penalised(self, found: ScoredHypothesis) -> ScoredHypothesis | None:
        """Return a hypothesis with its penalty; None if its pose is impossible."""
        penalty = self._penalty(found.T_cam_part)
        return replace(found, penalty=penalty) if np.isfinite(penalty) else None

    def _allowed(self, found: ScoredHypothesis) -> ScoredHypothesis | None:
        """Return a hypothesis with its penalty; None if its pose is impossible or ruled out."""
        if any(impossible(found.T_cam_part) for impossible in self._ruled_out):
            return None
        return self._penalised(found)
