"""What an exposure was taken for: the candidates, and how perception came to them."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from binpick_env.candidates import PoseCandidate

if TYPE_CHECKING:  # it brings the pose estimator's kernels, which the oracle does without
    from perception.pipeline import Perception


@dataclass(frozen=True, eq=False, kw_only=True)
class ObservedCandidates:
    """What a perceiver makes of one labelled_capture.

    Attributes:
        candidates: Seen parts, best first.
        perception: Boundary, segments and poses behind them: candidate i is pose i, a likely one where none was
            verified. None where the truth was read.
    """

    candidates: list[PoseCandidate] = field(default_factory=list)
    perception: "Perception | None" = None
