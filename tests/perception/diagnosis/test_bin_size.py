"""What is said of a bin whose opening has another size than the one given."""

from dataclasses import replace

import numpy as np
import pytest

from perception.bin import BinFit
from perception.diagnosis import BinFacts, Cause, bin_size_cause, no_bin_cause

GIVEN = np.array([0.36, 0.26, 0.12])
FOUND = BinFit(
    T_world_bin=np.eye(4),
    inner_size=GIVEN,
    opening=GIVEN[:2],
    translation_std=0.0002,
    rotation_std=0.001,
    points={"floor": 9, "rim": 9, "wall_x+": 9},
    residual=0.0003,
)


@pytest.mark.parametrize(
    ("opening", "reason", "text"),
    [
        (
            [0.18, 0.13],
            "its rim was not found",
            "an opening of about 180 x 130 mm was seen where 360 x 260 mm was said, 0.5 times as long and as wide: "
            "check the depth's unit (--depth-scale) or --bin",
        ),
        (
            [0.4, 0.26],
            "no",
            "360 x 260 mm was said: check --bin (--find-bin measures the size), or the depth's unit (--depth-scale)",
        ),
        ([0.37, 0.27], None, "opening measures 370 x 270 mm, but 360 x 260 mm was given: its walls reject poses"),
        ([np.nan, 0.27], None, "opening measures ? x 270 mm"),
        ([0.362, 0.262], None, None),
        ([np.nan, np.nan], "its rim was not found", None),
    ],
)
def test_the_size_seen_is_compared_with_the_size_given(
    opening: list[float], reason: str | None, text: str | None
) -> None:
    cause = bin_size_cause(replace(FOUND, opening=np.array(opening), reason=reason), GIVEN, ())
    if text is None:
        assert cause is None
    else:
        assert cause is not None
        assert cause.name == "bin_size"
        assert text in cause.text


def test_a_difference_within_the_uncertainty_or_by_a_unit_is_no_cause() -> None:
    off = replace(FOUND, opening=np.array([0.365, 0.265]), translation_std=0.002)
    assert bin_size_cause(off, GIVEN, ()) is None
    millimetres = Cause(name="depth_unit", text="the depth is in millimetres")
    assert bin_size_cause(replace(FOUND, opening=500 * GIVEN[:2]), GIVEN, (millimetres,)) is None


def test_the_cause_without_any_opening_names_the_options() -> None:
    assert "no opening was seen where a bin of 360 x 260 mm was said: check" in no_bin_cause(GIVEN).text
    assert "--depth-scale" in no_bin_cause(GIVEN).text


def test_the_facts_tell_the_opening_measured_from_the_size_given() -> None:
    facts = BinFacts.of(replace(FOUND, opening=np.array([0.3594, np.nan])), None, GIVEN)
    assert facts.opening == (pytest.approx(0.3594), None)
    assert "1 wall: an opening of 359 x ? mm, 360 x 260 x 120 mm inside as given (standard" in str(facts)
    facts = BinFacts.of(replace(FOUND, opening=np.full(2, np.nan)), None, GIVEN)
    assert "its opening was not seen as a whole, 360 x 260 x 120 mm inside as given" in str(facts)
    assert "wall: 360 x 260 x 120 mm inside (" in str(BinFacts.of(FOUND, None))


@pytest.mark.parametrize(
    ("fit", "text"),
    [
        (replace(FOUND, height=0.1), "inner_size height stated 120 mm, measured 100 mm: correct --bin, or let"),
        (replace(FOUND, height=0.124), None),
        (replace(FOUND, height=0.126, translation_std=0.0025), None),
        (
            replace(FOUND, height=0.1, points={"rim": 9, "wall_x+": 9}),
            "100 mm below the rim: parts fill the bin up to it",
        ),
        (replace(FOUND, height=0.112, points={"rim": 9, "wall_x+": 9}), None),  # flat parts may cover the floor
        (replace(FOUND, height=0.15, reason="no"), "the frame suggests at least 150 mm (no): correct --bin"),
    ],
)
def test_the_height_measured_is_compared_with_the_height_given(fit: BinFit, text: str | None) -> None:
    cause = bin_size_cause(fit, GIVEN, ())
    if text is None:
        assert cause is None
    else:
        assert cause is not None
        assert cause.name == "bin_size"
        assert text in cause.text


def test_an_opening_and_a_height_that_differ_are_one_cause() -> None:
    cause = bin_size_cause(replace(FOUND, opening=np.array([0.37, 0.27]), height=0.1), GIVEN, ())
    assert cause is not None
    assert "opening measures 370 x 270 mm" in cause.text
    assert "inner_size height stated 120 mm, measured 100 mm" in cause.text


def test_the_facts_say_that_an_unseen_floor_lies_where_the_stated_height_puts_it() -> None:
    hidden = replace(FOUND, points={"rim": 9, "wall_x+": 9})
    facts = BinFacts.of(hidden, None, GIVEN)
    assert facts.height_assumed == GIVEN[2]
    assert "its floor was not seen, so that it lies where the stated height of 120 mm puts it" in str(facts)
    facts = BinFacts.of(replace(hidden, height=0.114), None, GIVEN)
    assert facts.height_seen == 0.114
    assert str(facts).endswith("120 mm puts it: flat parts cover it, or it is 114 mm below the rim")
    assert BinFacts.of(FOUND, None, GIVEN).height_assumed is None
    assert BinFacts.of(hidden, None).height_assumed is None
