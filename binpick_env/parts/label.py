"""Label of a part: a name that is safe in file names and differs between files of different content."""

import hashlib
import re
from pathlib import Path

from perception.runtime.job_files import local_file

GENERATED = "generated:"  # prefix of the names of generated parts
DIGITS = 8  # number of hexadecimal digits of a file's SHA-256 in its label


def part_label(name_or_path: str | Path) -> str:
    """Return the label of a part, from which folders and files of results take their names.

    A name without a suffix, such as one of the catalogue, is its own label. A file's label is its stem and the
    beginning of the SHA-256 of its content, so two files of one name keep apart, and a file that was edited starts
    anew. Characters that some file systems refuse become hyphens.

    Args:
        name_or_path: Part as :func:`binpick_env.parts.part.load_part` takes it. A file that cannot be read has its
            stem as label: loading it will say why.
    """
    name = str(name_or_path)
    path = Path(name_or_path)
    if name.startswith(GENERATED) or not path.suffix:
        return _safe(name)
    try:
        content = hashlib.sha256(local_file(path).read_bytes()).hexdigest()[:DIGITS]
    except OSError:
        return _safe(path.stem)
    return f"{_safe(path.stem)}-{content}"


def _safe(name: str) -> str:
    return re.sub(r"[^\w.+-]+", "-", name).strip("-.") or "part"
