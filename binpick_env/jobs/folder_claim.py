"""A folder of results belongs to one configuration: they can be gone on with, but not mixed with another's."""

import json
from pathlib import Path
from typing import Any

from perception.runtime.files import json_text, write_atomically


def claim(note: Path, values: dict[str, Any], what: str) -> None:
    """Write ``values`` into the note, or compare them with what is noted there.

    Args:
        note: JSON file in the folder that is claimed.
        values: Everything that the results depend on, as JSON knows it.
        what: Name of the results, for the text.

    Raises:
        ValueError: Other values are noted, which the text tells apart from these; or the note cannot be read.
    """
    mine: dict[str, Any] = json.loads(json_text(values))
    if not note.exists():
        write_atomically(note, json_text(mine))
        return
    try:
        theirs = json.loads(note.read_text())
        names = sorted(name for name in {*mine, *theirs} if mine.get(name) != theirs.get(name))
    except (ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"{note} is damaged; choose another folder with --out, or delete this one") from error
    if names:
        different = ", ".join(f"{name}: {theirs.get(name)} there, {mine.get(name)} here" for name in names)
        raise ValueError(
            f"{note.parent} holds {what} of another configuration ({different}); "
            "choose another folder with --out, or delete this one"
        )
