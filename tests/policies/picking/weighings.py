"""Loads that seem to be something else each time they are weighed."""

from collections.abc import Iterator

import pytest

from policies.picking.load_check import LoadCheck


def weigh_as(monkeypatch: pytest.MonkeyPatch, *doubles: bool) -> Iterator[bool]:
    """Let the checks of a load measure as ever, but say in turn whether it is more than one part.

    Returns:
        The answers that are left.
    """
    answers = iter(doubles)
    decide = LoadCheck.decide

    def answered(check: LoadCheck) -> bool:
        decide(check)
        return next(answers)

    monkeypatch.setattr(LoadCheck, "decide", answered)
    return answers
