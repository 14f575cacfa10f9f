"""Right and wrong answers of the detectors, counted by hand."""

from policies.evaluation.double_summary import summarise_doubles
from policies.grasping.outcomes import DoubleCheck


def check(held: int, *, jaw: bool = False, weight: bool = False) -> DoubleCheck:
    return DoubleCheck(jaw_excess=0.0, load=1.0, jaw=jaw, weight=weight, held=held)


def test_each_detector_is_counted_against_the_truth() -> None:
    checks = [check(1), check(1, jaw=True), check(2, weight=True), check(3, jaw=True, weight=True), check(2)]
    assert summarise_doubles(checks) == {
        "lifts": 5,
        "doubles": 3,
        "jaw": {"detected": 1, "missed": 2, "false_alarms": 1},
        "weight": {"detected": 2, "missed": 1, "false_alarms": 0},
        "either": {"detected": 2, "missed": 1, "false_alarms": 1},
    }


def test_an_empty_lift_is_neither_right_nor_wrong() -> None:
    found = summarise_doubles([check(0, weight=True)])
    assert (found["lifts"], found["doubles"]) == (0, 0)
    assert found["weight"] == {"detected": 0, "missed": 0, "false_alarms": 0}
