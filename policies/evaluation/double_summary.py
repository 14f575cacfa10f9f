"""How well more than one part in the jaw was found, against the parts that truly came along."""

from collections.abc import Callable, Iterable

from policies.grasping.outcomes import DoubleCheck

Counts = dict[str, int]
_DETECTORS: dict[str, Callable[[DoubleCheck], bool | None]] = {  # None: not asked
    "jaw": lambda check: check.jaw,
    "weight": lambda check: check.weight,
    "image": lambda check: check.image,
    "either": lambda check: check.jaw or (check.weight if check.image is None else check.image),
}


def summarise_doubles(checks: Iterable[DoubleCheck]) -> dict[str, int | Counts]:
    """Return the number of lifts with a part, of doubles among them, and for each detector its right and wrong answers.

    The answers are counted whether or not the picker acts on them. The image is taken only after some lifts, of which
    there are ``lifts`` in its own counts. ``either`` is what all detectors say together: there the image, where one was
    taken, stands in place of the weight.

    Args:
        checks: What was measured after each lift. Those that lifted nothing are left out.
    """
    lifted = [check for check in checks if check.held > 0]
    found: dict[str, int | Counts] = {"lifts": len(lifted), "doubles": sum(check.held > 1 for check in lifted)}
    for name, says_double in _DETECTORS.items():
        answers = [(answer, check.held > 1) for check in lifted if (answer := says_double(check)) is not None]
        counts = {
            "detected": sum(answer and double for answer, double in answers),
            "missed": sum(double and not answer for answer, double in answers),
            "false_alarms": sum(answer and not double for answer, double in answers),
        }
        found[name] = {"lifts": len(answers), **counts} if name == "image" else counts
    return found
