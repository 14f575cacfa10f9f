"""Under what conditions bins were picked, for the line above the numbers."""

from collections.abc import Mapping
from typing import Any


def conditions(config: Mapping[str, Any]) -> tuple[str, ...]:
    """Return perception and sensor of an evaluation's plain configuration, and whatever made its bins harder."""
    facts = [str(config["perception"]), f"sensor {config['sensor']}"]
    if hand_eye := config["camera"]["hand_eye"]:
        facts.append(f"hand-eye {1000 * hand_eye:g} mm")
    if size := config["bin"]:
        facts.append("bin " + " x ".join(f"{1000 * edge:g}" for edge in size) + " mm")
    return tuple(facts)
