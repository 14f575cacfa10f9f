"""Right and wrong answers of the detectors, counted by hand."""

from policies.evaluation.double_summary import summarise_doubles
from policies.grasping.outcomes import DoubleCheck


def check(held: int, *, jaw: bool = False, weight: bool = False, image: bool | None = None) -> DoubleCheck:
    return DoubleCheck(jaw_excess=0.0, load=1.0, jaw=jaw, weight=weight, held=held, image=image)


def test_each_detector_is_counted_against_the_truth() -> None:
    checks = [check(1), check(1, jaw=True), check(2, weight=True), check(3, jaw=True, weight=True), check(2)]
    assert summarise_doubles(checks) == {
        "lifts": 5,
        "doubles": 3,
        "jaw": {"detected": 1, "missed": 2, "false_alarms": 1},
        "weight": {"detected": 2, "missed": 1, "false_alarms": 0},
        "image": {"lifts": 0, "detected": 0, "missed": 0, "false_alarms": 0},
        "either": {"detected": 2, "missed": 1, "false_alarms": 1},
    }


def test_where_an_image_was_taken_it_stands_in_place_of_the_weight() -> None:
    checks = [
        check(1, weight=True, image=False),
        check(1, image=True),
        check(2, image=True),
        check(3, image=True),
        check(2, weight=True, image=False),
        check(2, jaw=True, image=False),
        check(2, weight=True),
    ]
    found = summarise_doubles(checks)
    assert found["image"] == {"lifts": 6, "detected": 2, "missed": 2, "false_alarms": 1}
    assert found["weight"] == {"detected": 2, "missed": 3, "false_alarms": 1}
    assert found["either"] == {"detected": 4, "missed": 1, "false_alarms": 1}


def test_an_empty_lift_is_neither_right_nor_wrong() -> None:
    found = summarise_doubles([check(0, weight=True)])
    assert (found["lifts"], found["doubles"]) == (0, 0)
    assert found["weight"] == {"detected": 0, "missed": 0, "false_alarms": 0}
