"""Every bin that a noise model is fitted to has the seed, the sensor and the filling that were asked for."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binpick_env.config import CellConfig
from binpick_env.evaluation import noise_fit
from binpick_env.evaluation.noise_fit import observe_bins
from binpick_env.options import CellOptions
from binpick_env.parts.part import Part


def test_bins_are_observed_once_each_in_order_with_seeds_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[dict[str, Any]] = []

    class FakeEnv:
        """An environment whose candidates are its seed."""

        def __init__(self, part: Part, **settings: Any) -> None:
            built.append({"part": part.source, **settings})
            self.labelled_capture = "capture"

        def reset(self, *, seed: int) -> None:
            self.observed = SimpleNamespace(seed=seed)

    monkeypatch.setattr(noise_fit, "BinPickEnv", FakeEnv)
    monkeypatch.setattr(noise_fit, "_cells", {})
    monkeypatch.setattr(noise_fit, "compare_with_truth", lambda capture, observed: (capture, observed.seed))
    harsh, good = CellOptions(sensor="harsh", friction=0.3), CellOptions()
    frames = observe_bins(harsh, 3, 5, num_parts=(2, 9))
    seeds = [int(np.random.SeedSequence([5, index]).generate_state(1)[0]) for index in range(3)]
    assert frames == [("capture", seed) for seed in seeds]
    observe_bins(harsh, 1, 6, num_parts=(2, 9))
    settings = {"part": "tee", "num_parts": (2, 9), "perception": "learned", "threads": 1}
    hard = {**settings, "sensor": "harsh", "config": harsh.cell()}
    assert built == [hard]  # built once for all bins of the same settings
    observe_bins(good, 1, 6, num_parts=(2, 9))
    assert built[1:] == [{**settings, "sensor": "good", "config": CellConfig()}]
