"""The Protocol of everything that turns a capture into pose candidates."""

from typing import Protocol

import numpy as np

from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates


class Perceiver(Protocol):
    """Turns a labelled capture into pose candidates."""

    def perceive(
        self, labelled: LabelledCapture, rng: np.random.Generator, *, likely: bool = False
    ) -> ObservedCandidates:
        """Return the candidates, best first, and the segments and poses behind them.

        Args:
            labelled: Frame, with the ground truth for the perceivers that are allowed to read it.
            rng: Source of all random numbers.
            likely: Whether parts are candidates, too, that are likely but not verified; an oracle knows no such parts.
        """
        ...
