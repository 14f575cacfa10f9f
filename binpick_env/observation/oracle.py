"""The oracle: true poses, with Gaussian errors of a stated size where wanted."""

from dataclasses import dataclass

import numpy as np

from binpick_env.candidates import PoseCandidate
from binpick_env.observation.candidate_from_pose import make_candidate
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from perception.geometry import rotation_about
from perception.runtime.field_types import require_finite

OFFERED_FROM = 0.3  # visible fraction from which the oracle offers a part


@dataclass(frozen=True, kw_only=True)
class PoseNoise:
    """Gaussian error added to true poses.

    Attributes:
        translation: Standard deviation per axis of the translation error [m].
        rotation: Standard deviation of the rotation error's angle about a random axis [rad].
    """

    translation: float = 0.0
    rotation: float = 0.0

    def __post_init__(self) -> None:
        require_finite(self)
        if self.translation < 0 or self.rotation < 0:
            raise ValueError(f"noise must not be negative, got {self.translation} m and {self.rotation} rad")


class OraclePerceiver:
    """Offers the true poses of the parts that are visible enough, with pose noise of a stated size where wanted.

    Poses are true for the camera's reported position: the oracle shares the error of the hand-eye calibration.
    """

    def __init__(self, noise: PoseNoise | None = None, offered_from: float = OFFERED_FROM) -> None:
        """Create the oracle.

        Args:
            noise: Error added to each pose; None adds none.
            offered_from: Smallest visible fraction at which a part is offered.
        """
        self._noise = noise or PoseNoise()
        self._offered_from = offered_from

    def perceive(
        self,
        labelled: LabelledCapture,
        rng: np.random.Generator,
        *,
        likely: bool = False,  # noqa: ARG002 - for perceivers that are unsure
    ) -> ObservedCandidates:
        """Return a candidate for each part that is visible enough, the most visible first."""
        order = np.argsort(-labelled.visible_fractions, kind="stable")
        offered = [int(i) for i in order if labelled.visible_fractions[i] >= self._offered_from]
        return ObservedCandidates(candidates=[self._candidate(labelled, i, rng) for i in offered])

    def _candidate(self, labelled: LabelledCapture, i: int, rng: np.random.Generator) -> PoseCandidate:
        T_world_part = labelled.T_reported_parts[i].copy()
        if self._noise.translation > 0:
            T_world_part[:3, 3] += self._noise.translation * rng.normal(size=3)
        if self._noise.rotation > 0:
            turn = rotation_about(rng.normal(size=3), self._noise.rotation * rng.normal())
            # About the part's centre, so that a rotation error moves nothing but the rotation.
            arm = T_world_part[:3, :3] @ labelled.part.centre
            T_world_part[:3, 3] += arm - turn @ arm
            T_world_part[:3, :3] = turn @ T_world_part[:3, :3]
        fraction = float(labelled.visible_fractions[i])
        return make_candidate(labelled, T_world_part, score=1.0, visible_fraction=fraction, fill=fraction, part=i)
