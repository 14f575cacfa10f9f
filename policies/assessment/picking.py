"""Where the parts of picked bins are lost: the error budget as shares of all parts, and what stopped true poses."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from binpick_env.config import Perception
from policies.evaluation.budget import MODES, Budget
from policies.evaluation.records import BinRecord
from policies.grasping.outcomes import GraspOutcome


@dataclass(frozen=True, kw_only=True)
class Losses:
    """All settled parts as shares that add up to 1; the same bins with true poses, true segments and from pixels.

    A share is negative where the bins went better without a stage's ground truth, which happens by chance.

    Attributes:
        delivered: Share of the parts that is delivered from pixels.
        segmentation: Further share that is delivered with true segments.
        pose: Further share that is delivered with true poses.
        picking: Share that is not delivered even with true poses: grasps, motion and physics.
    """

    delivered: float
    segmentation: float
    pose: float
    picking: float

    def largest(self) -> str:
        """Return the name of the stage that loses most parts; "" if none loses any."""
        stages = {"segmentation": self.segmentation, "pose": self.pose, "picking": self.picking}
        name = max(stages, key=lambda stage: stages[stage])
        return name if stages[name] > 0 else ""


@dataclass(frozen=True, kw_only=True)
class PickingFacts:
    """How bins were picked, and where parts were lost.

    Attributes:
        bins: Number of bins.
        parts: Number of settled parts in all bins.
        gsr: Grasp success rate, deliveries of attempts, by perception; None without an attempt.
        dr: Share of the parts that was delivered, by perception.
        mpph: Mean picks per hour, by perception; None without an attempt.
        losses: Where the parts are lost.
        failures: Number of attempts with true poses that failed, by outcome.
        attempts: Number of attempts with true poses.
        ends: Number of bins with true poses, by the reason why they ended.
        left: Number of parts that were left in spite of true poses, by reason.
    """

    bins: int
    parts: int
    gsr: dict[str, float | None]
    dr: dict[str, float | None]
    mpph: dict[str, float | None]
    losses: Losses
    failures: dict[str, int]
    attempts: int
    ends: dict[str, int]
    left: dict[str, int]

    @property
    def failed(self) -> int:
        """Number of attempts with true poses that failed."""
        return sum(self.failures.values())


def picking_facts(budget: Budget, records: Mapping[Perception, Sequence[BinRecord]]) -> PickingFacts:
    """Return how bins were picked.

    Args:
        budget: The error budget of the bins.
        records: Records of the bins, by perception.
    """
    oracle = budget.modes["oracle"]
    parts = [part for record in records["oracle"] for part in record.undelivered or () if part.lost is None]
    reasons = Counter(str(part.reason) for part in parts if part.reason is not None)
    return PickingFacts(
        bins=budget.bins,
        parts=oracle.parts_total,
        gsr={mode: budget.modes[mode].gsr for mode in MODES},
        dr={mode: budget.modes[mode].dr for mode in MODES},
        mpph={mode: budget.modes[mode].mpph for mode in MODES},
        losses=losses(budget),
        failures={name: n for name, n in oracle.outcomes.items() if n and name != GraspOutcome.DELIVERED},
        attempts=oracle.attempts,
        ends={name: count for name, count in oracle.termination.items() if count},
        left=dict(reasons.most_common()),
    )


def losses(budget: Budget) -> Losses:
    """Return the shares of all parts that each stage loses."""
    learned, gt_masks, oracle = (budget.modes[mode].dr or 0.0 for mode in ("learned", "gt_masks", "oracle"))
    return Losses(delivered=learned, segmentation=gt_masks - learned, pose=oracle - gt_masks, picking=1.0 - oracle)
