"""Numbers in words."""

import pytest

from binpick_env.jobs.text_tables import counted


@pytest.mark.parametrize(("number", "text"), [(0, "0 bins"), (1, "1 bin"), (2, "2 bins"), (20, "20 bins")])
def test_one_is_singular(number: int, text: str) -> None:
    assert counted(number, "bin") == text
