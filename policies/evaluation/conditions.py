"""The conditions under which bins were picked, for the line above the numbers, and what they do not measure."""

from collections.abc import Mapping
from typing import Any

GIVEN = "given"  # shown in place of a number that was not measured
_SEGMENTS = ("ap", "ap50", "ap75")
_POSES = ("candidate_pose_accuracy", "candidate_precision", "candidate_recall", "pose_error")


def given_numbers(perception: str) -> frozenset[str]:
    """Return the keys of results.json that a perception mode does not measure, because the ground truth is given."""
    given = {"oracle": (*_SEGMENTS, *_POSES), "gt_masks": _SEGMENTS}
    return frozenset(given.get(perception, ()))


def conditions(config: Mapping[str, Any], weights: Mapping[str, Any] | None = None) -> tuple[str, ...]:
    """Return perception and sensor of an evaluation, and every setting of the cell that is not the standard one.

    Args:
        config: Fields of an :class:`policies.evaluation.config.EvaluationConfig` as plain values, by name; those of
            earlier versions have no jaw and no friction.
        weights: ``name`` of the network that perception used, and whether it was trained on the part (``training``).
    """
    network = f" ({weights['name']}, {weights['training']})" if weights else ""
    facts = [f"{config['perception']}{network}", f"sensor {config['sensor']}"]
    if hand_eye := config["camera"]["hand_eye"]:
        facts.append(f"hand-eye {1000 * hand_eye:g} mm")
    if turn := config.get("hand_eye_deg"):
        facts.append(f"hand-eye {turn:g} degrees")
    if config.get("trust") == "bin":
        facts.append("camera's pose corrected by the bin")
    if size := config["bin"]:
        facts.append("bin " + " x ".join(f"{1000 * edge:g}" for edge in size) + " mm")
    if jaw := config.get("jaw"):
        facts.append(f"jaw {1000 * jaw:g} mm")
    if acceleration := config.get("max_acceleration"):
        facts.append(f"acceleration {acceleration:g} rad/s^2")
    if jerk := config.get("max_jerk"):
        facts.append(f"jerk {jerk:g} rad/s^3")
    if (friction := config.get("friction")) is not None:
        facts.append(f"friction {friction:g}")
    return tuple(facts)


def flat_settings(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested settings by dotted names, such as ``camera.distance``."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= flat_settings(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {f"{prefix}{name}": value}
    return flat
