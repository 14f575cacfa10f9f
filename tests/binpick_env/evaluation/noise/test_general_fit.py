"""The fit of a model for every part: by hand, and by drawing again; what pools with what."""

from dataclasses import replace

import numpy as np
import pytest

from binpick_env.evaluation.noise.bins import ObservedBin
from binpick_env.evaluation.noise.general_fit import MIN_DESIGNS, MIN_FRAMES, MIN_POSES, MIN_SEEN, fit_general_noise
from binpick_env.observation.part_class import CLASSES, PartClass, ShapeClass
from tests.binpick_env.evaluation.noise.observed_bins import drawn_bins, observed, row


def designs(shape: ShapeClass, count: int, found: int, missed: int, *, d_max: float = 0.07) -> list[ObservedBin]:
    """Return a bin of each of some designs, with found and missed parts."""
    rows = [row(found=True)] * found + [row(found=False)] * missed
    return [observed(f"{shape}-{d_max}-{k}", shape, rows, d_max=d_max) for k in range(count)]


def test_the_numbers_are_what_the_site_says() -> None:
    assert (MIN_SEEN, MIN_POSES, MIN_DESIGNS, MIN_FRAMES) == (40, 20, 3, 9)


def test_a_class_that_was_seen_enough_has_its_own_rates() -> None:
    bins = [*designs("flat", 3, 10, 10), *designs("slender", 3, 20, 0)]
    noise = fit_general_noise(bins, {"seed": 4})
    flat, slender = (noise.classes[PartClass("medium", shape)].bin_of(0.9) for shape in ("flat", "slender"))
    assert (flat.count, flat.offered, slender.count, slender.offered) == (60, 0.5, 60, 1.0)
    assert noise.provenance == {"seed": 4}
    seen = noise.classes[PartClass("medium", "flat")].provenance
    assert (len(seen["parts"]), seen["bins"]) == (3, 3)
    assert noise.classes[PartClass("large", "flat")].provenance == {"parts": [], "bins": 0}


def test_a_class_that_was_seen_too_little_takes_its_shapes_rates_and_then_all() -> None:
    two_designs = designs("flat", 2, 0, 30, d_max=0.03)  # small; enough parts, but of two designs
    few_parts = designs("flat", 3, 0, 13, d_max=0.15)  # large; 39 parts
    noise = fit_general_noise([*designs("flat", 3, 10, 10), *two_designs, *few_parts, *designs("slender", 3, 20, 0)])
    rates = {key: noise.classes[key].bin_of(0.9) for key in CLASSES}
    for size in ("small", "large"):
        assert rates[PartClass(size, "flat")].count == 60 + 60 + 39  # type: ignore[arg-type]
        assert rates[PartClass(size, "flat")].offered == pytest.approx(30 / 159, rel=1e-4)  # type: ignore[arg-type]
    assert rates[PartClass("medium", "flat")].offered == 0.5
    assert rates[PartClass("small", "compact")].count == 60 + 60 + 39 + 60  # no compact part was seen
    assert rates[PartClass("small", "slender")].offered == 1.0


def test_lengths_are_shares_of_d_max_and_errors_pool_where_correct_poses_are_few() -> None:
    flat = [observed(f"f{k}", "flat", [row(error=0.004)] * 10, d_max=0.08) for k in range(3)]
    slender = [observed(f"s{k}", "slender", [row(error=0.001)] * 6, d_max=0.05) for k in range(3)]  # 18 correct poses
    noise = fit_general_noise([*flat, *slender])
    own, pooled = (noise.classes[PartClass("medium", shape)] for shape in ("flat", "slender"))
    assert own.bin_of(0.9).spread.translation == pytest.approx((0.05,) * 11)
    assert pooled.bin_of(0.9).spread.translation[0] == pytest.approx(0.02)
    assert pooled.bin_of(0.9).spread.translation[-1] == pytest.approx(0.05)
    # Nothing was seen at another visible fraction: errors are those of the class over all fractions.
    assert own.bin_of(0.3).spread.translation == pytest.approx((0.05,) * 11)
    assert (own.bin_of(0.3).count, own.bin_of(0.3).offered) == (0, 0.0)
    # No pose is wrong: the correct ones stand in.
    assert own.wrong.rotation[-1] == 0.01


def test_wrong_poses_and_false_candidates_are_the_classes_own() -> None:
    flawed = [row(correct=False, error=0.035)] * 7
    flat = [observed(f"f{k % 3}", "flat", [row(), *flawed], false_scores=(0.25, 0.5)) for k in range(9)]
    slender = [observed(f"s{k % 3}", "slender", [row(), row(correct=False, error=0.07)]) for k in range(9)]
    noise = fit_general_noise([*flat, *slender])
    one, other = (noise.classes[PartClass("medium", shape)] for shape in ("flat", "slender"))
    assert one.wrong.translation == pytest.approx((0.5,) * 11)
    assert (one.wrong.translation[0], other.wrong.translation[-1]) == pytest.approx((0.5, 1.0))  # 9 wrong: pooled
    assert (one.false_rate, other.false_rate) == (2.0, 0.0)
    assert (one.false_score[0], one.false_score[-1]) == (0.25, 0.5)
    assert one.bin_of(0.9).wrong == pytest.approx((63 + 9) / 90)  # 9 correct poses are too few, as are all 18


def test_the_fit_gives_back_the_rates_of_its_bins() -> None:
    rng = np.random.default_rng(0)
    bins = [
        *drawn_bins("flat", 12, rng, offered=0.4, wrong=0.3),
        *drawn_bins("compact", 12, rng, offered=0.9, wrong=0.05),
    ]
    noise = fit_general_noise(bins)
    for shape, offered, wrong in (("flat", 0.4, 0.3), ("compact", 0.9, 0.05)):
        own = noise.classes[PartClass("medium", shape)]  # type: ignore[arg-type]
        drawn = [own.draw(visible, rng) for visible in rng.uniform(0.0, 1.0, 4000)]
        found = [errors for errors in drawn if errors is not None]
        assert len(found) / len(drawn) == pytest.approx(offered, abs=0.08)
        assert np.mean([errors.wrong for errors in found]) == pytest.approx(wrong, abs=0.08)
        assert own.false_rate == pytest.approx(0.5)


def test_nothing_right_cannot_be_fitted() -> None:
    unsettled = replace(observed("a", "flat", []), frame=None)
    with pytest.raises(ValueError, match="2 bins hold no correct pose: there is nothing to fit"):
        fit_general_noise([observed("a", "flat", [row(correct=False)]), unsettled])
