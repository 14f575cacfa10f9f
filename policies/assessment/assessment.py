"""An assessment as a whole: what was measured, what to do about it, how long it took; the keys of assessment.json."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, git_commit, versions
from policies.assessment.advice import Advice
from policies.assessment.findings import Findings
from policies.evaluation.budget import Budget


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """A part, assessed.

    Attributes:
        findings: Everything that was measured.
        advice: What to do about the part, in the order in which to do it; empty if nothing is to be done.
        budget: The error budget of the picked bins; None if none was picked.
        seed: Seed of scenes and bins.
        seconds: Wall clock of each stage of this run [s]; stages whose results were there already take nearly none.
        command: Command line of the process.
        git_commit: Commit of the code.
        versions: Versions of Python, platform and packages.
    """

    findings: Findings
    advice: tuple[Advice, ...]
    budget: Budget | None
    seed: int
    seconds: dict[str, float]
    command: str = field(default_factory=command_line)
    git_commit: str = field(default_factory=git_commit)
    versions: dict[str, str] = field(default_factory=versions)

    def plain(self) -> dict[str, Any]:
        """Return every field by its name, as assessment.json holds it; an infinite length becomes null."""
        findings = asdict(self.findings)
        values = {name: _finite(findings[name]) for name in findings if name != "options"}
        return {
            "options": findings["options"],
            **values,
            "advice": [asdict(piece) for piece in self.advice],
            "budget": None if self.budget is None else self.budget.plain(),
            **{name: getattr(self, name) for name in ("seed", "seconds", "command", "git_commit", "versions")},
        }


def save_assessment(path: Path, assessment: Assessment) -> None:
    """Write an assessment as JSON, in one piece."""
    write_atomically(path, json_text(assessment.plain()))


def _finite(values: Any) -> Any:
    if isinstance(values, dict):
        return {name: _finite(value) for name, value in values.items()}
    return None if isinstance(values, float) and np.isinf(values) else values
