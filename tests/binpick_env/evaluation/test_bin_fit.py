"""The measurement of bins, measured."""

import pytest

from binpick_env.config import CameraConfig
from binpick_env.evaluation.bin_fit import BinFitConfig, BinTrial, bin_fit_table, measure_bins
from binpick_env.scenes.synthesis import SceneConfig

SCENES = SceneConfig(num_parts=(2, 3), camera=CameraConfig(width=640, height=480))


@pytest.mark.slow
def test_a_bin_is_measured_in_a_simulated_frame() -> None:
    one, other = measure_bins(BinFitConfig(scenes=SCENES), 2, 1)
    assert (one.index, one.reason, other.reason) == (0, None, None)
    assert 5 < one.believed_mm < 60
    for trial in (one, other):
        assert trial.error_mm < 1.0
        assert trial.error_deg < 0.2
    (again,) = measure_bins(BinFitConfig(scenes=SCENES), 1, 1)
    assert (again.error_mm, again.error_deg) == (one.error_mm, one.error_deg)


def test_the_table_has_medians_and_the_reasons_of_failures() -> None:
    good = [
        BinTrial(index=k, reason=None, believed_mm=20.0, error_mm=0.1 * k, error_deg=0.01 * k, ms=30.0)
        for k in range(3)
    ]
    bad = BinTrial(index=3, reason="its rim was not found", believed_mm=20.0, error_mm=None, error_deg=None, ms=10.0)
    lines = bin_fit_table([*good, bad]).splitlines()
    assert lines[0].startswith("reliable fits: 3/4 = 75.0 % (30.1 % to 95.4 %)")
    assert lines[3].split()[:4] == ["position", "error", "[mm]", "0.10"]
    assert lines[-1] == "scene 3: its rim was not found"
    assert "–" in bin_fit_table([bad])


@pytest.mark.parametrize("name", ["off_mm", "off_deg"])
def test_an_error_without_sense_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} must be 0 or more and finite, got -1"):
        BinFitConfig(scenes=SCENES, **{name: -1.0})
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        next(measure_bins(BinFitConfig(scenes=SCENES), 0, 1))
