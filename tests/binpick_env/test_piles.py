"""The standard bin of every part settles, and is as cluttered as it is documented to be."""

import numpy as np
import pytest

from binpick_env.cell.settle import inside_bin
from binpick_env.config import CameraConfig
from binpick_env.env import BinPickEnv
from binpick_env.parts import CATALOGUE
from tests.binpick_env.small_cell import deepest_overlap

SEEDS = (1, 2)
NOISE = 0.06  # of a share of some 50 parts


@pytest.mark.slow
@pytest.mark.parametrize("part", CATALOGUE)
def test_the_standard_bin_settles_and_is_cluttered(part: str) -> None:
    env = BinPickEnv(part=part, perception="oracle", camera=CameraConfig(width=320, height=240))
    fractions = []
    for seed in SEEDS:
        env.reset(seed=seed)
        assert env.simulation.asleep().all()
        np.testing.assert_array_equal(inside_bin(env.simulation), env.simulation.in_play)
        assert deepest_overlap(env.simulation) < 0.0015
        fractions.append(env.labelled_capture.visible_fractions[env.simulation.in_play])
    env.close()
    seen = np.concatenate(fractions)
    assert len(seen) >= 20 * len(SEEDS)
    assert np.mean(seen < 0.5) >= 0.20 - NOISE
    assert np.mean(seen > 0.9) <= 0.40 + NOISE
