"""Cells whose parts are laid by hand, one of each kind for all tests of a file."""

from functools import partial

import pytest

pytest.register_assert_rewrite("tests.policies.hand_cell")

from policies.grasping import grasps  # noqa: E402
from tests.policies.hand_cell import SMALL_BIN, HandCell, hand_cell  # noqa: E402
from tests.shared_models import share_models  # noqa: E402


@pytest.fixture(autouse=True, scope="session")
def _models_are_shared() -> None:
    share_models()


@pytest.fixture(scope="module")
def tees() -> HandCell:
    return hand_cell("tee", SMALL_BIN)


@pytest.fixture(scope="module")
def lids() -> HandCell:
    return hand_cell("part_b")


@pytest.fixture(scope="module")
def wheels() -> HandCell:
    return hand_cell("part_a")


@pytest.fixture
def coarse_grasps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sample the grasps of a part of one's own coarsely, where it matters only that there are some."""
    coarse = partial(grasps.sample_grasps, settings=grasps.GraspSettings(samples=20, turns=4))
    monkeypatch.setattr(grasps, "sample_grasps", coarse)
