"""Settings of an assessment: what they refuse, and which evaluations they make."""

from pathlib import Path

import pytest

from binpick_env.options import CellOptions
from binpick_env.parts import load_part
from policies.assessment.config import AssessmentConfig
from policies.assessment.part import other_units
from policies.assessment.run import AssessmentJob


def test_scenes_and_bins_have_the_same_part_seed_and_numbers() -> None:
    options = CellOptions(
        part="tee", jaw=0.06, camera_distance=1.0, sensor="harsh", hand_eye_mm=3.0, bin=(0.3, 0.2, 0.1)
    )
    config = AssessmentConfig(options=options, seed=5, num_parts=(3, 4))
    part = load_part("tee")
    scenes, picks = config.perception(part).scenes, config.picks(part)
    for each in (scenes, picks):
        assert (each.part, each.seed, each.num_parts, each.sensor, each.bin) == ("tee", 5, (3, 4), "harsh", options.bin)
        assert each.camera.distance == 1.0
    assert (scenes.camera.hand_eye, picks.camera.hand_eye, picks.jaw) == (0.0, 0.003, 0.06)


def test_a_small_bin_gets_as_many_parts_as_it_holds() -> None:
    part = load_part("tee")
    assert AssessmentConfig().parts_in_a_bin(part) == (20, 30)
    small = AssessmentConfig(options=CellOptions(bin=(0.15, 0.15, 0.12)))
    low, high = small.parts_in_a_bin(part)
    assert low == high < 20


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenes": 0}, "scenes must be at least 1, got 0"),
        ({"bins": 0}, "bins must be at least 1, got 0"),
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"num_parts": (3, 2)}, r"num_parts must be a rising pair from 1, got \(3, 2\)"),
    ],
)
def test_nonsense_is_refused(arguments: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AssessmentConfig(**arguments)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        AssessmentJob(out=Path(), workers=0)


def test_other_units_are_those_of_a_plausible_part() -> None:
    assert other_units(0.022, "mm") == pytest.approx({"cm": 0.22})
    assert other_units(0.08, "mm") == {}
    assert other_units(0.08, "cm") == pytest.approx({"inch": 0.2032})
