"""What the numbers of a bin's size may mean."""

import pytest

from perception.bin.unit import bin_units, bin_words


@pytest.mark.parametrize(
    ("numbers", "units"),
    [
        ((0.36, 0.26, 0.12), {"metres"}),
        ((360, 260, 120), {"millimetres"}),
        ((36, 26, 12), {"centimetres", "inches"}),
        ((90, 50, 30), {"millimetres", "centimetres"}),
        ((0.36, 0.26, 0.0), set()),
        ((5000, 3000, 1), set()),
    ],
)
def test_units_are_those_that_make_a_bin(numbers: tuple[float, ...], units: set[str]) -> None:
    assert set(bin_units(numbers)) == units


def test_the_words_say_what_to_type() -> None:
    words = "--bin 360x260x120 if centimetres were meant or --bin 914.4x660.4x304.8 if inches were meant"
    assert bin_words((36, 26, 12), without="metres") == words
    assert bin_words((36, 26, 12), without="metres", longest=0.5) == words.split(" or ")[0]
    assert bin_words((360, 260, 120), without="millimetres") == ""
