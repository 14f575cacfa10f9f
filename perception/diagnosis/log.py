"""Causes in the log, each once per process: a fault of the setup is in every frame."""

import logging
from collections.abc import Collection

from perception.diagnosis.report import CauseName, FrameReport

_log = logging.getLogger(__name__)
_logged: set[CauseName] = set()


def log_causes(report: FrameReport, *, without: Collection[CauseName] = ()) -> None:
    """Log the causes of a report as warnings, except those that this process has already logged.

    Args:
        report: Report of a frame.
        without: Causes that are not logged.
    """
    for cause in report.causes:
        if cause.name not in _logged and cause.name not in without:
            _logged.add(cause.name)
            _log.warning("%s", cause.text)
