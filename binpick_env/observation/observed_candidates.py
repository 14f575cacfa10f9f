"""What a perceiver made of a capture: the candidates, and the perception behind them."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from binpick_env.candidates import PoseCandidate

if TYPE_CHECKING:  # importing it would load the pose estimator's kernels, which the oracle does without
    from perception.pipeline import Perception


@dataclass(frozen=True, eq=False, kw_only=True)
class ObservedCandidates:
    """Pose candidates of one labelled capture.

    Attributes:
        candidates: Candidates, best first.
        perception: Boundary, segments and poses behind them: candidate i is pose i. Where none was verified, and
            where likely candidates were asked for, the likely poses are among them. None for an oracle, which reads the
            ground truth.
    """

    candidates: list[PoseCandidate] = field(default_factory=list)
    perception: "Perception | None" = None
