"""Fingertips are lowered while they press too little, raised while they press too much, within limits."""

import pytest

from policies.grasping.pushes import PushSettings
from policies.picking.press_control import PressControl

SETTINGS = PushSettings(drag_force=20.0, compliance=1e-4, largest_change=1e-3, lower=0.005, higher=0.002)


def test_a_stiff_part_is_pressed_with_the_force_that_is_asked_for() -> None:
    control, force = PressControl(SETTINGS), 0.0
    for _ in range(60):
        force = max(0.0, 5e3 * (control.felt(force) - 0.001))  # felt 1 mm below the planned way; 5 N for a millimetre
    assert force == pytest.approx(20.0, abs=0.1)
    assert control.lower == pytest.approx(0.005, abs=1e-4)


@pytest.mark.parametrize(("force", "end"), [(0.0, 0.005), (1000.0, -0.002)])
def test_the_height_changes_slowly_and_within_limits(force: float, end: float) -> None:
    control = PressControl(SETTINGS)
    lower = [control.felt(force) for _ in range(10)]
    changes = [b - a for a, b in zip([0.0, *lower], lower, strict=False)]
    assert max(abs(change) for change in changes) == pytest.approx(SETTINGS.largest_change)
    assert lower[-1] == end


def test_a_single_bounce_is_smoothed() -> None:
    control = PressControl(PushSettings(largest_change=1.0, lower=1.0, higher=1.0))
    control.felt(25.0)
    assert control.felt(45.0) == pytest.approx(-10.0 * PushSettings().compliance)


def test_the_force_that_is_asked_for_changes_nothing() -> None:
    assert PressControl(SETTINGS).felt(20.0) == 0.0
