"""From the records of evaluated scenes to the numbers that are printed; the field names are the JSON's keys."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig
from binpick_env.evaluation.segmentation.method import MethodConfig
from binpick_env.evaluation.segmentation.record import STAGES, SceneRecord, record_path
from binpick_env.scenes.clutter import ClutterStats, pooled_clutter
from perception.metrics.average_precision import ap_summary, bootstrap_ap
from perception.metrics.matching import SceneMatches
from perception.part import PartModel
from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, versions
from perception.segmentation.weights import load_record, training_of

BANDS = ((0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, np.inf))  # visible fractions, [low, high)
PAPER = {"ap50": 0.505, "ap75": 0.254}  # table 2 of the paper, its whole method
NOTE = (
    "Scenes are synthetic, with simulated sensor noise. The paper tested on 20 hand-labelled real scenes of its own "
    "Part A, which are not public (AP50 50.5, AP75 25.4): the two are not the same test."
)


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneScore:
    """Scores of a scene's predicted instances.

    Attributes:
        index: Index of the scene.
        matches: Predicted instances matched to the parts.
        bands: Matches where only the parts of one band of `BANDS` count, one entry for each band.
        ap: Average precision of this scene alone; NaN without a part to find.
        points: Number of boundary points.
        wrong_side: Number of boundary points on the wrong side of a contour.
        contour: Number of boundary points at contours.
        clutter: Statistics of the visible fractions.
        ms: Wall clock of each stage [ms].
        threads: Number of threads that computed the scene.
        git_commit: Commit of the code that made the record.
    """

    index: int
    matches: SceneMatches
    bands: tuple[SceneMatches, ...]
    ap: float
    points: int
    wrong_side: int
    contour: int
    clutter: ClutterStats
    ms: dict[str, float]
    threads: int
    git_commit: str

    @classmethod
    def from_record(cls, record: SceneRecord, index: int) -> "SceneScore":
        """Score the record of scene ``index``."""
        matches = record.matches()
        return cls(
            index=index,
            matches=matches,
            bands=tuple(record.matches(band) for band in BANDS),
            ap=ap_summary([matches]).ap,
            points=len(record.labels),
            wrong_side=record.wrong_side,
            contour=record.contour,
            clutter=record.clutter,
            ms=record.ms,
            threads=record.threads,
            git_commit=record.git_commit,
        )


@dataclass(frozen=True, kw_only=True)
class BandSummary:
    """Numbers of the parts in one band of visible fractions; predictions on parts outside it are ignored.

    Attributes:
        low: Lower limit of the visible fraction, inclusive.
        high: Upper limit of the visible fraction, exclusive below 1.
        parts: Number of parts to find in the band.
        ap: Mean average precision over IoU 0.50, 0.55 ... 0.90; NaN without a part.
        ap50: Average precision at an IoU of 0.5; NaN without a part.
        ap75: Average precision at an IoU of 0.75; NaN without a part.
        ap25: Average precision at an IoU of 0.25; NaN without a part.
        found50: Share of the parts that some prediction matches with an IoU over 0.5, whatever its score.
        found75: Share of the parts that some prediction matches with an IoU over 0.75, whatever its score.
    """

    low: float
    high: float
    parts: int
    ap: float
    ap50: float
    ap75: float
    ap25: float
    found50: float
    found75: float


@dataclass(frozen=True, kw_only=True)
class SegmentationSummary:
    """Numbers of an evaluation. AP is ScanNet's, over parts with a visible fraction of at least 0.1.

    Attributes:
        ap: Mean average precision over IoU 0.50, 0.55 ... 0.90; NaN without a part to find.
        ap50: Average precision at an IoU of 0.5; NaN without a part to find.
        ap75: Average precision at an IoU of 0.75; NaN without a part to find.
        ap25: Average precision at an IoU of 0.25; NaN without a part to find.
        intervals: 95 % intervals of the four, by percentile bootstrap over scenes.
        ms_per_scene: Median time from a frame to labelled points [ms].
        ms: Median time of each stage [ms]: boundary, surface, segmentation (network and grouping), total.
        threads: Numbers of threads that scenes were computed on.
        by_visible_fraction: Numbers by band of visible fractions.
        clutter: Median visible fraction (mean of the scenes' medians), shares of parts below 0.5 and above 0.9, and the
            number of parts.
        scenes: Number of scenes.
        points_per_scene: Median number of boundary points, all of which are labelled and scored.
        wrong_side: Share of all boundary points that lie on the wrong side of a contour.
        wrong_side_at_contours: Share of the boundary points at contours that lie on the wrong side.
        part: Part in the bins.
        sensor: Preset of the depth sensor's noise.
        seed: Seed of the scenes.
        method: Settings of the segmentation method.
        weights: Path and SHA-256 of the weights, with commit, parts, steps, minutes and scenes of their training; None
            without a network.
        paper: AP50 and AP75 that the paper reports.
        note: How far these numbers and the paper's can be compared.
        config: All settings.
        command: Command line of the process that computed the summary.
        git_commits: Commits of the code that made the records; several if the code changed between them.
        versions: Versions of Python, platform and packages.
    """

    ap: float
    ap50: float
    ap75: float
    ap25: float
    intervals: dict[str, tuple[float, float]]
    ms_per_scene: float
    ms: dict[str, float]
    threads: list[int]
    by_visible_fraction: list[BandSummary]
    clutter: dict[str, float | None]
    scenes: int
    points_per_scene: float
    wrong_side: float
    wrong_side_at_contours: float
    part: str
    sensor: str
    seed: int
    method: dict[str, Any]
    weights: dict[str, Any] | None
    paper: dict[str, float] = field(default_factory=PAPER.copy)
    note: str = NOTE
    config: dict[str, Any]
    command: str = field(default_factory=command_line)
    git_commits: list[str]
    versions: dict[str, str] = field(default_factory=versions)


def load_scores(folder: Path, count: int) -> list[SceneScore]:
    """Load and score the records of scenes 0 to ``count - 1``.

    Args:
        folder: Folder of the records.
        count: Number of scenes.

    Raises:
        RecordError: A record is missing or damaged.
    """
    return [SceneScore.from_record(SceneRecord.load(record_path(folder, index)), index) for index in range(count)]


def summarise(
    config: EvaluationConfig, scores: Sequence[SceneScore], rng: np.random.Generator, resamples: int = 1000
) -> SegmentationSummary:
    """Summarise the scores of all scenes.

    Args:
        config: Configuration of the evaluation.
        scores: Score of each scene.
        rng: Random generator of the bootstrap.
        resamples: Number of bootstrap resamples.

    Raises:
        ValueError: There is no scene.
    """
    if not scores:
        raise ValueError("there is nothing to sum up: no scene was evaluated")
    matches = [score.matches for score in scores]
    whole = ap_summary(matches)
    ms = {name: float(np.median([score.ms[name] for score in scores])) for name in STAGES}
    return SegmentationSummary(
        ap=whole.ap,
        ap50=whole.ap50,
        ap75=whole.ap75,
        ap25=whole.ap25,
        intervals=asdict(bootstrap_ap(matches, rng, resamples)),
        ms_per_scene=ms["total"],
        ms=ms,
        threads=sorted({score.threads for score in scores}),
        by_visible_fraction=[
            _band(low, high, [score.bands[k] for score in scores]) for k, (low, high) in enumerate(BANDS)
        ],
        clutter=pooled_clutter([score.clutter for score in scores]),
        scenes=len(scores),
        points_per_scene=float(np.median([score.points for score in scores])),
        wrong_side=_quotient(sum(score.wrong_side for score in scores), sum(score.points for score in scores)),
        wrong_side_at_contours=_quotient(
            sum(score.wrong_side for score in scores), sum(score.contour for score in scores)
        ),
        part=config.scenes.part,
        sensor=config.scenes.sensor,
        seed=config.scenes.seed,
        method=config.method.settings(),
        weights=weights_provenance(config.method, config.scenes.options().load_part().model),
        config=config.settings(),
        git_commits=sorted({score.git_commit for score in scores}),
    )


def save_summary(path: Path, summary: Any) -> None:
    """Write a summary, which is a dataclass, as JSON; the file is replaced atomically."""
    write_atomically(path, json_text(asdict(summary)))


def weights_provenance(method: MethodConfig, part: PartModel) -> dict[str, Any] | None:
    """Return path, SHA-256 and training of a method's weights; None without weights.

    Args:
        method: Segmentation method.
        part: Part that is segmented; ``training`` says whether the network was trained on it.
    """
    if method.weights is None:
        return None
    record = load_record(method.weights)
    made = {name: record.get(name) for name in ("git_commit", "parts", "steps", "minutes", "scenes")}
    sha256, training = method.digest(), training_of(record, part)
    return {"path": str(method.weights), "sha256": sha256, "training": training, **made}


def weights_name(weights: dict[str, Any]) -> str:
    """Return the file name of weights, with whether they were trained on the part where that is known."""
    name = Path(weights["path"]).name
    return f"{name}, {weights['training']}" if weights.get("training") else name


def _quotient(count: int, total: int) -> float:
    return count / total if total else np.nan


def _band(low: float, high: float, matches: Sequence[SceneMatches]) -> BandSummary:
    summary = ap_summary(matches)
    parts = sum(sum(scene.truth_counts.values()) for scene in matches)
    found = []
    for overlap in (0.5, 0.75):
        at = [scene.correct[scene.overlap_idx == scene.overlaps.index(overlap)].sum() for scene in matches]
        found.append(sum(at) / parts if parts else np.nan)
    return BandSummary(
        low=low,
        high=min(high, 1.0),
        parts=parts,
        ap=summary.ap,
        ap50=summary.ap50,
        ap75=summary.ap75,
        ap25=summary.ap25,
        found50=float(found[0]),
        found75=float(found[1]),
    )
