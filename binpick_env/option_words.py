"""Options of a cell as the words of a command line, so that messages name commands that can be pasted."""

import shlex
from dataclasses import fields

from binpick_env.options import CellOptions

# options that do not change a scene
_NOT_SCENES = ("jaw", "max_acceleration", "max_jerk", "hand_eye_mm", "hand_eye_deg", "trust")
_NOT_TRAINING = (*_NOT_SCENES, "sensor")  # options that binpick train-segmentation does not have


def option_words(options: CellOptions, only: tuple[str, ...] | None = None) -> list[str]:
    """Return the options of a scene that are not the standard ones as the words of a command line.

    Args:
        options: Part and cell.
        only: Names of the options to return; all that change a scene if None.
    """
    words = []
    for field in fields(options):
        value = getattr(options, field.name)
        named = field.name not in _NOT_SCENES if only is None else field.name in only
        if named and (value != field.default or field.name == "part"):
            values = value if isinstance(value, tuple) else (value,)
            words += [f"--{field.name.replace('_', '-')}", *(f"{each}" for each in values)]
    return words


def training_command(options: CellOptions, network: str = "grid") -> str:
    """Return the command that trains a network for a part alone, on scenes of its cell.

    Args:
        options: Part and cell.
        network: Kind of the network, see `perception.segmentation.choices.NetworkName`.
    """
    names = tuple(each.name for each in fields(options) if each.name not in _NOT_TRAINING)
    kind = [] if network == "grid" else ["--preset", network, "--install", "True"]
    words = ["binpick", "train-segmentation", *option_words(options, only=names), *kind]
    return shlex.join([*words, "--initial", "none", "--minutes", "60"])
