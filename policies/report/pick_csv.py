"""All decisions of an evaluation as a table of comma-separated values."""

import csv
import io
from collections.abc import Sequence

import numpy as np

from policies.evaluation.records import BinRecord, PickRecord

COLUMNS = (
    "bin",
    "seed",
    "decision",
    "outcome",
    "abstention",
    "part",
    "delivered",
    "failed_at",
    "frame",
    "width_mm",
    "opening_mm",
    "score",
    "t_sense_s",
    "t_compute_s",
    "t_motion_s",
    "candidate",
    "candidate_score",
    "pose_correct",
    "translation_error_mm",
    "rotation_error_deg",
    "segment_iou",
    "picture",
    "push",
    "t_concurrent_s",
)


def picks_csv(records: Sequence[BinRecord]) -> str:
    """Return one line for each decision under a line of column names; a cell is empty where there is no value.

    The features that the grasp was ranked by follow in columns of their own names.
    """
    features = sorted({name for record in records for pick in record.picks for name in pick.features})
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*COLUMNS, *(f"feature_{name}" for name in features)])
    for record in records:
        for number, pick in enumerate(record.picks):
            writer.writerow([*_cells(record, number, pick), *(pick.features.get(name) for name in features)])
    return text.getvalue()


def _cells(record: BinRecord, number: int, pick: PickRecord) -> list[object]:
    seen = record.candidate(pick)
    translation = None if seen is None else seen.translation
    rotation = None if seen is None else seen.rotation
    return [
        record.index,
        record.seed,
        number,
        pick.outcome,
        pick.abstention,
        pick.part if pick.part >= 0 else None,
        pick.delivered,
        pick.failure_attribution,
        pick.frame_id,
        _scaled(pick.width, 1000),
        _scaled(pick.opening, 1000),
        pick.score,
        pick.t_sense,
        pick.t_compute,
        pick.t_motion,
        pick.candidate,
        None if seen is None else seen.score,
        None if seen is None else int(seen.right),
        _scaled(translation, 1000),
        _scaled(rotation, 180 / np.pi),
        None if seen is None else seen.overlap,
        pick.picture or None,
        pick.push,
        pick.t_concurrent,
    ]


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else round(value * factor, 6)
