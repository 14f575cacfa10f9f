"""A folder of results has one configuration: results can be resumed, but not mixed with another configuration's."""

import json
from pathlib import Path
from typing import Any

from perception.runtime.files import json_text, write_atomically


def ensure_same_config(path: Path, values: dict[str, Any], what: str) -> None:
    """Write the configuration of a folder, or compare it with the one that is there.

    Args:
        path: JSON file that holds the folder's configuration.
        values: Everything that the results depend on, as JSON types.
        what: Name of the results for the error message, such as "scenes".

    Raises:
        ValueError: The file holds another configuration (the message lists the differences), or cannot be read.
    """
    given: dict[str, Any] = json.loads(json_text(values))
    if not path.exists():
        write_atomically(path, json_text(given))
        return
    try:
        stored = json.loads(path.read_text())
        names = sorted(name for name in {*given, *stored} if given.get(name) != stored.get(name))
    except (ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is damaged; choose another folder with --out, or delete this one") from error
    if names:
        different = ", ".join(f"{name}: {stored.get(name)} there, {given.get(name)} here" for name in names)
        raise ValueError(
            f"{path.parent} holds {what} of another configuration ({different}); "
            "choose another folder with --out, or delete this one"
        )
