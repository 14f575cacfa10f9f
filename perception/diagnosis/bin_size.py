"""Whether the bin has the size that was given."""

import numpy as np

from perception.bin import BinFit
from perception.diagnosis.report import Cause, CauseName
from perception.geometry import Floats

_DIFFERENT, _SIGMAS = 0.003, 3.0  # difference of a measured opening from the one given from which it counts [m]
_SCALED, _ALIKE = 0.2, 0.1  # least relative error of a wrong unit, and largest difference of the two sides' ratios
_LAYER = 0.01  # height of a level above the stated floor from which the stated height is doubted [m]
_OTHER_HEIGHT = 0.005  # the same of heights [m]: rims are rounded, and the floor is found all the same
# What is said of a bin's place, size or camera: it says nothing where there is no bin.
ABOUT_BIN: frozenset[CauseName] = frozenset(
    {"inner_size_unit", "bin_pose", "floor_height", "thin_part", "partly_outside"}
)


def bin_size_cause(fit: BinFit, given: Floats, causes: tuple[Cause, ...]) -> Cause | None:
    """Return the cause of an opening or a height that is not that of the bin that was given; None if they are.

    Args:
        fit: The bin as the frame shows it.
        given: (3,) inner length, width and height [m] that were given.
        causes: Causes known already: a unit that is wrong by 1000 explains the opening, too.
    """
    if any(cause.name in ("depth_unit", "inner_size_unit") for cause in causes):
        return None
    texts = [text for text in (_opening_text(fit, given), _height_text(fit, given)) if text is not None]
    return Cause(name="bin_size", text="; ".join(texts)) if texts else None


def _opening_text(fit: BinFit, given: Floats) -> str | None:
    """Return what is said of an opening of another length or width; None if there is none."""
    ratio, away = fit.opening / given[:2], np.abs(fit.opening - given[:2])
    least = max(_DIFFERENT, _SIGMAS * fit.translation_std) if fit.reliable else _DIFFERENT
    if not np.any(away > least):  # NaN is no difference
        return None
    seen = " x ".join("?" if np.isnan(value) else f"{1000 * value:.0f}" for value in fit.opening)
    said = " x ".join(f"{1000 * value:.0f}" for value in given[:2])
    if fit.reliable:
        return (
            f"the bin's opening measures {seen} mm, but {said} mm was given: its walls reject poses by the size given; "
            "correct --bin, or let --find-bin measure the size"
        )
    factor = float(np.mean(ratio))
    unit = abs(factor - 1) >= _SCALED and abs(ratio[0] / ratio[1] - 1) <= _ALIKE
    scaled = f", {factor:.2g} times as long and as wide" if unit else ""
    check = (
        "the depth's unit (--depth-scale) or --bin"
        if unit
        else "--bin (--find-bin measures the size), or the depth's unit (--depth-scale)"
    )
    return f"an opening of about {seen} mm was seen where {said} mm was said{scaled}: check {check}"


def _height_text(fit: BinFit, given: Floats) -> str | None:
    """Return what is said of another height of the rim above the floor; None if it is as given, or not seen."""
    away, said = abs(fit.height - given[2]), f"inner_size height stated {1000 * given[2]:.0f} mm"
    if fit.reliable and "floor" not in fit.seen:
        level = f"the lowest level seen is {1000 * fit.height:.0f} mm below the rim"
        check = "parts fill the bin up to it, or the height is wrong: check --bin"
        return f"{said}, but {level}: {check}" if away > _LAYER else None  # NaN is no difference
    advice = "correct --bin, or let --find-bin measure the size"
    if not fit.reliable:
        suggested = f"the frame suggests at least {1000 * fit.height:.0f} mm ({fit.reason})"
        return None if np.isnan(fit.height) else f"{said}, {suggested}: {advice}, or correct --bin-pose"
    if "floor" not in fit.seen or not away > max(_OTHER_HEIGHT, _SIGMAS * fit.translation_std):
        return None
    return f"{said}, measured {1000 * fit.height:.0f} mm: {advice}"


def no_bin_cause(given: Floats) -> Cause:
    """Return the cause where a bin of (3,) inner size ``given`` [m] was not found, no other opening, and no part."""
    said = " x ".join(f"{1000 * value:.0f}" for value in given[:2])
    text = (
        f"no opening was seen where a bin of {said} mm was said: check the depth's unit (--depth-scale), --bin, and "
        "that the whole rim is in view"
    )
    return Cause(name="bin_size", text=text)
