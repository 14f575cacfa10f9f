"""What a user chooses among where camera and bin disagree. It loads nothing, so that commands start fast."""

from typing import Literal, get_args

Trust = Literal["camera", "bin"]  # what is right where a frame shows the bin elsewhere than it is said to be


def check_trust(trust: str) -> None:
    """Raise ``ValueError`` unless ``trust`` is one of `Trust`."""
    if trust not in get_args(Trust):
        raise ValueError(f"trust must be one of {', '.join(get_args(Trust))}, got {trust!r}")
