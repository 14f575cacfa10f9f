"""A folder of results has one configuration: results can be resumed, but not mixed with another configuration's."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from perception.runtime.files import json_text, write_atomically


def ensure_same_config(
    path: Path,
    values: dict[str, Any],
    what: str,
    renamed: Mapping[str, str] | None = None,
    assumed: Mapping[str, Any] | None = None,
) -> None:
    """Write the configuration of a folder, or compare it with the one that is there.

    Args:
        path: JSON file that holds the folder's configuration.
        values: Everything that the results depend on, as JSON types.
        what: Name of the results for the error message, such as "scenes".
        renamed: Present names of values by their names in files of the previous version.
        assumed: Values that files of older versions lack, as they are to be understood, where ``values`` has them.

    Raises:
        ValueError: The file holds another configuration (the message lists the differences), or cannot be read.
    """
    renamed = renamed or {}
    given: dict[str, Any] = json.loads(json_text(values))
    if not path.exists():
        # The previous names are written, too, for one version.
        write_atomically(path, json_text(given | {old: given[name] for old, name in renamed.items()}))
        return
    try:
        stored = {
            renamed.get(name, name): value for name, value in json.loads(path.read_text(encoding="utf-8")).items()
        }
        stored = {name: value for name, value in (assumed or {}).items() if name in given} | stored
        names = sorted(name for name in {*given, *stored} if given.get(name) != stored.get(name))
    except (ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is damaged; choose another folder with --out, or delete this one") from error
    if names:
        different = ", ".join(f"{name}: {stored.get(name)} there, {given.get(name)} here" for name in names)
        raise ValueError(
            f"{path.parent} holds {what} of another configuration ({different}); "
            "choose another folder with --out, or delete this one"
        )
