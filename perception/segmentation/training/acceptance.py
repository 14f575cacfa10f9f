"""Whether a trained network is good enough to be installed without being asked for."""

from perception.segmentation.training.run import Log

LEAST_AP50 = 0.5  # smallest AP50 on the validation scenes of a network that is worth using


def objection(last: Log, first: Log | None = None) -> str | None:
    """Return the reason not to use a network, or None if there is none.

    Args:
        last: Last line of the log of its training. A network without validation is not judged.
        first: Line of step 0, the evaluation of the network that the training started from on the same scenes.
    """
    found = last.get("validation")
    if not found:
        return None
    if not found["ap50"] >= LEAST_AP50:  # NaN is refused, too
        return f"its AP50 on the validation scenes, {found['ap50']:.3f}, is under {LEAST_AP50}"
    before = (first or {}).get("validation")
    if before and before["ap"] is not None and found["ap"] < before["ap"]:
        return f"its AP on the validation scenes, {found['ap']:.3f}, is under the {before['ap']:.3f} it started from"
    return None


def scores(line: Log) -> str:
    """Return the average precisions in a line of a log as text, or "" if there are none."""
    found = line.get("validation") or {}
    names = {"ap50": "AP50", "ap75": "AP75", "ap": "AP"}
    return ", ".join(f"{shown} {found[name]:.3f}" for name, shown in names.items() if found.get(name) is not None)
