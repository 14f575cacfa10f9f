"""Plot of a training: average precision on the validation scenes against minutes."""

from collections.abc import Sequence
from itertools import product

from binpick_env.jobs.report_style import curves, svg_file
from perception.segmentation.training.run import Log

NAMES = {"ap50": "AP50", "ap75": "AP75", "ap": "AP"}
_NICE = (1.0, 1.2, 1.6, 2.0, 2.4, 3.2, 4.0, 6.0, 8.0, 10.0)  # quarters of these have few digits


def ap_plot(log: Sequence[Log]) -> str | None:
    """Return AP50, AP75 and AP against minutes as the text of an SVG file, or None if nothing was evaluated.

    Args:
        log: Lines of the log of a training. Minutes are those of the training, after those that its scenes took.
    """
    lines = [line for line in log if line.get("validation")]
    if not lines:
        return None
    minutes = [line["minutes"] + line.get("scene_minutes", 0.0) for line in lines]
    plotted = []
    for name, shown in NAMES.items():
        values = [line["validation"].get(name) for line in lines]
        points = [(x, y) for x, y in zip(minutes, values, strict=True) if y is not None]
        plotted.append((f"{shown} {points[-1][1]:.3f}" if points else shown, points))
    spent = ", with those for scenes" if any(line.get("scene_minutes") for line in lines) else ""
    return svg_file(curves(plotted, f"minutes{spent}", "average precision", _axis_end(max(minutes))))


def _axis_end(most: float) -> float:
    """Return the smallest of the nice numbers that is at least ``most``, and at least 0.001."""
    return next(end for k, nice in product(range(-3, 9), _NICE) if (end := nice * 10.0**k) >= most)
