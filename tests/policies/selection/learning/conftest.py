"""Cells without physics in place of the simulated ones."""

import pytest

from policies.selection.learning.experience import Cells
from tests.policies.selection.learning.toy_selection import toy


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("policies.selection.learning.experience._environments", {})
    monkeypatch.setattr(Cells, "environment", toy)
