"""The unit of a bin's size: suspected where no bin is so large, or the measurements fill the bin in another unit."""

from dataclasses import replace

from perception.bin.unit import NAMES, bin_units
from perception.diagnosis.report import Cause
from perception.diagnosis.samples import BoxFit, DepthSamples
from perception.diagnosis.setup import Setup
from perception.size import METRES

LARGEST_BIN = 10.0  # length [m] of no bin; no bin is 10 mm long either
_LARGE_BIN = 3.0  # length [m] of hardly a bin
_FITS = 0.5  # least share of the measurements in the box, and of the box in view, if the bin has this size
_REACHED = 0.6  # least height of what is measured in the bin, as a share of its own, if its rim is seen
_EMPTY = 0.3  # the same below which the bin is not as high as that
_DIVISORS = {"millimetres": 1000, "centimetres": 100, "inches": 39.37}  # from numbers in a unit to metres


def size_unit_cause(samples: DepthSamples, setup: Setup) -> tuple[Cause, float] | None:
    """Return the cause of a size that is not in metres, and the factor that makes it metres; None if it is.

    Args:
        samples: Depth measurements of the frame.
        setup: Camera and bin as they were given.
    """
    longest = float(setup.inner_size.max())
    if longest < _LARGE_BIN:
        return None
    fits = {unit: replace(setup, inner_size=setup.inner_size * scale).fit(samples) for unit, scale in METRES.items()}
    plausible = [unit for unit in METRES if unit != "m" and NAMES[unit] in bin_units(setup.inner_size.tolist())]
    # A box in a smaller unit lies within the bin, and is full, too: the largest one that is full is the likeliest.
    full = sorted((u for u in plausible if _fills(fits[u])), key=lambda unit: METRES[unit], reverse=True)
    reached = [unit for unit in full if fits[unit].top >= _REACHED * METRES[unit] * setup.inner_size[2]]
    if longest < LARGEST_BIN and not (reached and fits["m"].top < _EMPTY * setup.inner_size[2]):
        return None
    unit = (reached or full or plausible or ["mm"])[0]
    size = " x ".join(f"{value:g}" for value in setup.inner_size)
    typed = "x".join(f"{1000 * METRES[unit] * value:.6g}" for value in setup.inner_size)
    text = (
        f"inner_size is {size} m: it seems to be in {NAMES[unit]}; divide it by {_DIVISORS[NAMES[unit]]:g} "
        f"(--bin {typed} on the command line)"
    )
    return Cause(name="inner_size_unit", text=text), METRES[unit]


def _fills(fit: BoxFit) -> bool:
    return fit.inside >= _FITS and fit.view >= _FITS
