"""One large result is kept, and never two at once."""

import weakref

import pytest

from perception.runtime.last_result import LastResult


class Large:
    def __init__(self, number: int, name: str = "") -> None:
        self.text = f"{number}{name}"


def test_a_result_is_made_once_and_goes_before_the_next_is_made() -> None:
    made: list[weakref.ref[Large]] = []

    @LastResult
    def make(number: int, name: str = "") -> Large:
        assert [each for each in made if each() is not None] == []
        large = Large(number, name)
        made.append(weakref.ref(large))
        return large

    assert make(3) is make(3)
    assert make(3, name="a").text == "3a"
    assert make(3, name="b").text == "3b"
    assert make(3).text == "3"
    assert len(made) == 4
    make.cache_clear()
    assert made[-1]() is None


def test_nothing_is_kept_of_a_call_that_fails() -> None:
    @LastResult
    def divide(number: int) -> float:
        """Divide one by a number."""
        return 1 / number

    assert divide(2) == 0.5
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            divide(0)
    assert divide(4) == 0.25
    assert divide.__doc__ == "Divide one by a number."
