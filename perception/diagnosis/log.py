"""Causes in the log, each once per process: a fault of the setup is in every frame."""

import logging
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from perception.diagnosis.report import CauseName, FrameReport

_log = logging.getLogger(__name__)
_logged: set[CauseName] = set()
_quiet: ContextVar[bool] = ContextVar("quiet", default=False)


@contextmanager
def causes_unlogged() -> Iterator[None]:
    """Log no causes within this context, nor count them as logged: for frames that no user took."""
    token = _quiet.set(True)
    try:
        yield
    finally:
        _quiet.reset(token)


def log_causes(report: FrameReport, *, without: Collection[CauseName] = ()) -> None:
    """Log the causes of a report as warnings, except those that this process has already logged.

    Nothing is logged within :func:`causes_unlogged`.

    Args:
        report: Report of a frame.
        without: Causes that are not logged.
    """
    if _quiet.get():
        return
    for cause in report.causes:
        if cause.name not in _logged and cause.name not in without:
            _logged.add(cause.name)
            _log.warning("%s", cause.text)
