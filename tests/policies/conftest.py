"""Cells whose parts are laid by hand, one of each kind for all tests of a file."""

import pytest

pytest.register_assert_rewrite("tests.policies.hand_cell")

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
