"""Cells with the standard camera, in which parts are seen by their pixels, and what their tests ask of them."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from binpick_env.candidates import PoseCandidate
from binpick_env.env import BinPickEnv
from perception.metrics.pose_errors import is_recognised, pose_error
from perception.pipeline import Perception
from perception.segmentation import weights


@pytest.fixture(autouse=True, scope="module")
def no_weights_of_the_users_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("weights")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(weights, "user_folder", lambda: folder)
        yield


def cell(part: str = "tee", num_parts: int = 3, perception: str = "learned", **options: Any) -> BinPickEnv:
    """Return a cell with the standard camera."""
    return BinPickEnv(part, num_parts, perception, **{"threads": 1, **options})


def seen_in(env: BinPickEnv) -> Perception:
    assert env.observed.perception is not None
    return env.observed.perception


def in_play(env: BinPickEnv) -> set[int]:
    return {int(i) for i in np.flatnonzero(env.simulation.in_play)}


def assert_right(env: BinPickEnv, candidates: list[PoseCandidate]) -> None:
    """Check that each candidate is where the part is that it is said to be of."""
    part, truth = env.part.model, env.simulation.part_poses()
    for candidate in candidates:
        error = pose_error(candidate.T_world_part, truth[candidate.part], part)
        assert is_recognised(error, part.d_max), (candidate.part, error)
