"""The frame that ships with the package: small files to try everything on."""

import shutil
from pathlib import Path

SOURCE = Path(__file__).parent / "example"


def example_files() -> tuple[str, ...]:
    """Return the names of the example's files."""
    return tuple(sorted(path.name for path in SOURCE.iterdir()))


def copy_example(folder: str | Path) -> Path:
    """Copy the example: a depth image, its grey image, camera, bin and part.

    Args:
        folder: Folder that the files are copied to; it is made.

    Returns:
        The folder.

    Raises:
        ValueError: One of the files is there already.
    """
    folder = Path(folder)
    there = [name for name in example_files() if (folder / name).exists()]
    if there:
        raise ValueError(f"{folder} must not hold {', '.join(there)} yet: choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    for name in example_files():
        shutil.copyfile(SOURCE / name, folder / name)
    return folder
