"""The check of a model for every part: rates on parts that it was not fitted to."""

from dataclasses import replace

import numpy as np
import pytest

from binpick_env.evaluation.noise.check import check_on_left_out_parts
from tests.binpick_env.evaluation.noise.observed_bins import drawn_bins, observed, row


@pytest.mark.slow
def test_drawn_rates_are_the_observed_ones_where_parts_of_a_class_are_alike() -> None:
    rng = np.random.default_rng(1)
    bins = [
        *drawn_bins("flat", 22, rng, offered=0.4, wrong=0.3),
        *drawn_bins("slender", 22, rng, offered=0.9, wrong=0.05),
        replace(observed("restless", "flat", []), frame=None),
    ]
    flat, slender, total = check_on_left_out_parts(bins, rng)
    assert [each.shape for each in (flat, slender, total)] == ["flat", "slender", "all"]
    assert [each.designs for each in (flat, slender, total)] == [22, 22, 44]
    assert [each.seen for each in (flat, slender, total)] == [1320, 1320, 2640]
    for each, offered, wrong in ((flat, 0.4, 0.3), (slender, 0.9, 0.05)):
        assert each.offered == pytest.approx((offered, offered), abs=0.06)
        assert each.wrong == pytest.approx((wrong, wrong), abs=0.06)
        assert each.false == pytest.approx((0.5, 0.5), abs=0.06)
    assert total.offered[0] == pytest.approx((flat.offered[0] + slender.offered[0]) / 2)


def test_a_part_that_no_other_is_like_shows() -> None:
    """It is compared with a fit to the others: the only slender part is missed, all flat ones are found."""
    bins = [observed(f"flat-{k}", "flat", [row()] * 40) for k in range(5)]
    flat, slender, _ = check_on_left_out_parts(
        [*bins, observed("slender", "slender", [row(found=False)] * 40)], np.random.default_rng(0)
    )
    assert slender.offered == (0.0, 1.0)
    assert flat.offered[0] == 1.0
    assert np.isnan(slender.wrong[0])


def test_without_other_parts_there_is_nothing_to_compare() -> None:
    only = check_on_left_out_parts([observed("a", "flat", [row()])], np.random.default_rng(0))
    assert [(each.shape, each.seen) for each in only] == [("all", 0)]
    assert np.isnan(only[0].offered).all()
