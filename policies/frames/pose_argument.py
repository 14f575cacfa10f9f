"""Poses as a user gives them: sixteen numbers, or the name of a JSON file."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from perception.capture.text_files import read_text
from perception.geometry import Floats, require_rigid

_OPTIONS = {"T_world_bin": "--bin-pose", "T_world_cam": "--camera-pose", "T_world_base": "--robot-base"}


def parse_pose(words: Sequence[str], name: str) -> Floats:
    """Return a pose from its numbers or from a file.

    Args:
        words: The sixteen numbers of a (4, 4) transform row by row, or one word: the path of a JSON file that holds
            them as a list of 16, as four lists of 4, or as either under the key ``name``.
        name: Name of the pose, such as ``T_world_bin``.

    Returns:
        (4, 4) float64 transform.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: There are not sixteen numbers, or they are no rotation and translation.
    """
    values = _stored_pose(Path(words[0]), name) if len(words) == 1 else words
    try:
        numbers = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be 16 numbers row by row, got {values}{_option(name)}") from error
    if numbers.size != 16:
        raise ValueError(
            f"{name} must be 16 numbers row by row, or one JSON file of them, got {numbers.size} numbers{_option(name)}"
        )
    pose: Floats = numbers.reshape(4, 4)
    require_rigid(name, pose)
    return pose


def _stored_pose(path: Path, name: str) -> object:
    """Return what a JSON file holds, under the key ``name`` if it is an object.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is no JSON, or an object without that key.
    """
    if not path.exists():
        raise FileNotFoundError(
            f"{name}: there is no file {path}; give a JSON file, or 16 numbers row by row{_option(name)}"
        )
    try:
        content = json.loads(read_text(path))
    except ValueError as error:
        raise ValueError(f"{name}: {path} is no JSON file: {error}") from error
    if isinstance(content, dict):
        if name not in content:
            raise ValueError(f"{name}: {path} has no key {name!r}, only {', '.join(map(repr, content))}")
        return content[name]
    return content


def _option(name: str) -> str:
    """Return which option a pose is given by, in brackets after a space; nothing if it is not one of a command."""
    return f" ({_OPTIONS[name]} on the command line)" if name in _OPTIONS else ""
