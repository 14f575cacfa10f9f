"""Summary of an ablation: each row's mean over trainings, with intervals over trainings and scenes."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.segmentation.summary import SceneScore
from perception.geometry import Floats
from perception.metrics.average_precision import percentile_interval, weighted_ap
from perception.runtime.provenance import command_line, git_commit, versions

METRICS = ("ap", "ap50", "ap75", "ap25")
RESAMPLES = 1000  # bootstrap resamples
NOTE = (
    "Scenes are synthetic, with simulated sensor noise, and the trainings are short; the paper trained for 200 epochs "
    "and tested on 20 hand-labelled real scenes of its own Part A, which are not public."
)


@dataclass(frozen=True, eq=False, kw_only=True)
class RowScores:
    """Scores of all trainings of a row.

    Attributes:
        key: Key of the row.
        name: Name of the row in the printed table.
        paper: AP50 and AP75 of this row in the paper; None without such a row.
        scores: Scores of all scenes, one sequence for each training.
        chosen: Grouping distance of each training.
        tried: AP on validation scenes by grouping distance, for each training.
        minutes: Duration of each training [min]; None where nothing is learned.
    """

    key: str
    name: str
    paper: tuple[float, float] | None
    scores: tuple[Sequence[SceneScore], ...] = ()
    chosen: tuple[float, ...] = ()
    tried: tuple[dict[str, float], ...] = ()
    minutes: tuple[float | None, ...] = ()

    def with_training(
        self, scores: Sequence[SceneScore], chosen: float, tried: dict[str, float], minutes: float | None
    ) -> "RowScores":
        """Return the row with the scores of another training added."""
        return replace(
            self,
            scores=(*self.scores, scores),
            chosen=(*self.chosen, chosen),
            tried=(*self.tried, tried),
            minutes=(*self.minutes, minutes),
        )


@dataclass(frozen=True, kw_only=True)
class RowResult:
    """Numbers of a row: means over its trainings, with 95 % intervals over trainings and scenes.

    Attributes:
        key: Key of the row.
        name: Name of the row in the printed table.
        ap: Mean average precision over IoU 0.50, 0.55 ... 0.90.
        ap50: Average precision at an IoU of 0.5.
        ap75: Average precision at an IoU of 0.75.
        ap25: Average precision at an IoU of 0.25.
        intervals: 95 % intervals of ap, ap50, ap75 and ap25.
        gain: Difference of each to the row above, (value, low, high); None in the first row.
        each: ap, ap50, ap75 and ap25 of each training.
        chosen: Embedding threshold or radius [m] of each training, chosen by AP on validation scenes.
        tried: AP on validation scenes by threshold or radius, for each training.
        minutes: Duration of each training [min]; None where nothing is learned.
        ms_per_scene: Median time from a frame to labelled points [ms].
        paper: AP50 and AP75 of this row in the paper, on real scenes; None without such a row.
    """

    key: str
    name: str
    ap: float
    ap50: float
    ap75: float
    ap25: float
    intervals: dict[str, tuple[float, float]]
    gain: dict[str, tuple[float, float, float]] | None
    each: list[dict[str, float]]
    chosen: list[float]
    tried: list[dict[str, float]]
    minutes: list[float | None]
    ms_per_scene: float
    paper: dict[str, float] | None


@dataclass(frozen=True, kw_only=True)
class AblationTable:
    """All rows of an ablation.

    Attributes:
        rows: Rows in the order of the table.
        scenes: Number of scenes that every row was evaluated on.
        trainings: Number of trainings of each learned row.
        threads: Numbers of threads that scenes were computed on.
        config: All settings that the table depends on.
        note: How far these numbers and the paper's can be compared.
        command: Command line of the process that made the table.
        git_commits: Commits of the code that made the records and the table.
        versions: Versions of Python, platform and packages.
    """

    rows: list[RowResult]
    scenes: int
    trainings: int
    threads: list[int]
    config: dict[str, Any]
    note: str = NOTE
    command: str = field(default_factory=command_line)
    git_commits: list[str]
    versions: dict[str, str] = field(default_factory=versions)


def tabulate(
    rows: Sequence[RowScores], config: dict[str, Any], rng: np.random.Generator, resamples: int = RESAMPLES
) -> AblationTable:
    """Tabulate rows that were evaluated on the same scenes.

    Args:
        rows: Scores of each row, in the order of the table.
        config: All settings that the table depends on.
        rng: Random generator of the bootstrap.
        resamples: Number of bootstrap resamples; all rows share the drawn scenes, and each row's trainings are drawn.

    Raises:
        ValueError: There is no row, or a row has no training.
    """
    if not rows or not all(row.scores for row in rows):
        raise ValueError("there is nothing to tabulate: a row without a training, or no row")
    scenes, most = len(rows[0].scores[0]), max(len(row.scores) for row in rows)
    weights = rng.multinomial(scenes, np.full(scenes, 1.0 / scenes), size=resamples).astype(np.float64)
    draws = {len(row.scores): rng.integers(len(row.scores), size=(resamples, len(row.scores))) for row in rows}
    results: list[RowResult] = []
    above: tuple[Floats, Floats] | None = None
    for row in rows:
        each = np.stack([_ap(scores, np.ones((1, scenes)))[0] for scores in row.scores])
        resampled = _resampled(row, weights, draws[len(row.scores)])
        results.append(_result(row, each, resampled, above))
        above = each.mean(axis=0), resampled
    every = [score for row in rows for scores in row.scores for score in scores]
    return AblationTable(
        rows=results,
        scenes=scenes,
        trainings=most,
        threads=sorted({score.threads for score in every}),
        config=config,
        git_commits=sorted({score.git_commit for score in every} | {git_commit()}),
    )


def _resampled(row: RowScores, weights: Floats, draws: NDArray[np.int64]) -> Floats:
    """Return (R, 4) means over the (R, K) drawn trainings, with scenes weighted by (R, S) ``weights``."""
    values = np.stack([_ap(scores, weights) for scores in row.scores])
    drawn: Floats = values[draws, np.arange(len(weights))[:, None]].mean(axis=1)
    return drawn


def _ap(scores: Sequence[SceneScore], weights: Floats) -> Floats:
    return weighted_ap([score.matches for score in scores], weights)


def _result(row: RowScores, each: Floats, resampled: Floats, above: tuple[Floats, Floats] | None) -> RowResult:
    mean = dict(zip(METRICS, each.mean(axis=0).tolist(), strict=True))
    gain = None
    if above is not None:
        differences = each.mean(axis=0) - above[0]
        ends = [percentile_interval((resampled - above[1])[:, k]) for k in range(len(METRICS))]
        gain = {name: (float(differences[k]), *ends[k]) for k, name in enumerate(METRICS)}
    return RowResult(
        key=row.key,
        name=row.name,
        ap=mean["ap"],
        ap50=mean["ap50"],
        ap75=mean["ap75"],
        ap25=mean["ap25"],
        intervals={name: percentile_interval(resampled[:, k]) for k, name in enumerate(METRICS)},
        gain=gain,
        each=[dict(zip(METRICS, values, strict=True)) for values in each.tolist()],
        chosen=list(row.chosen),
        tried=list(row.tried),
        minutes=list(row.minutes),
        ms_per_scene=float(np.median([score.ms["total"] for scores in row.scores for score in scores])),
        paper=None if row.paper is None else {"ap50": row.paper[0], "ap75": row.paper[1]},
    )
