"""Results as JSON with their provenance."""

from typing import Any

from perception.runtime.files import json_text
from perception.runtime.provenance import command_line, git_commit, versions


def recorded(values: dict[str, Any]) -> str:
    """Return ``values`` as JSON, with the command, the commit and the package versions."""
    return json_text({**values, "command": command_line(), "git_commit": git_commit(), "versions": versions()})
