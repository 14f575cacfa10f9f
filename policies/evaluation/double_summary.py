"""How well more than one part in the jaw was found, against the parts that truly came along."""

from collections.abc import Callable, Iterable

from policies.grasping.outcomes import DoubleCheck

Counts = dict[str, int]
_DETECTORS: dict[str, Callable[[DoubleCheck], bool]] = {
    "jaw": lambda check: check.jaw,
    "weight": lambda check: check.weight,
    "either": lambda check: check.jaw or check.weight,
}


def summarise_doubles(checks: Iterable[DoubleCheck]) -> dict[str, int | Counts]:
    """Return the number of lifts with a part, of doubles among them, and for each detector its right and wrong answers.

    The answers are counted whether or not the picker acts on them.

    Args:
        checks: What was measured after each lift. Those that lifted nothing are left out.
    """
    lifted = [check for check in checks if check.held > 0]
    doubles = [check for check in lifted if check.held > 1]
    found: dict[str, int | Counts] = {"lifts": len(lifted), "doubles": len(doubles)}
    for name, says_double in _DETECTORS.items():
        detected = sum(says_double(check) for check in doubles)
        found[name] = {
            "detected": detected,
            "missed": len(doubles) - detected,
            "false_alarms": sum(says_double(check) for check in lifted) - detected,
        }
    return found
