"""Figures with where they come from."""

from typing import Any

from perception.runtime.files import json_text
from perception.runtime.provenance import command_line, git_commit, versions


def recorded(values: dict[str, Any]) -> str:
    """Return ``values`` as JSON, with command, commit and versions."""
    return json_text({**values, "command": command_line(), "git_commit": git_commit(), "versions": versions()})
