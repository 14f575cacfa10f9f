"""Records of the verdicts on every test room of a trained row."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from perception.metrics.matching import SceneMatches
from perception.runtime.records import RecordFormat
from perception.s3dis.choices import RowName

FORMAT = RecordFormat(kind="judged row", version=1, remedy="s3dis_table makes it again")


@dataclass(frozen=True, eq=False, kw_only=True)
class JudgedRow:
    """The verdicts on a training of a row, on every test room.

    Attributes:
        row: Row of Table 1.
        seed: Seed of the training.
        names: Names of the rooms.
        matches: Verdicts on each room.
    """

    row: RowName
    seed: int
    names: tuple[str, ...]
    matches: tuple[SceneMatches, ...]


def save_judged(path: Path, judged: JudgedRow) -> None:
    """Write the verdicts as JSON, atomically."""
    rooms = [{"name": name, **_plain(m)} for name, m in zip(judged.names, judged.matches, strict=True)]
    FORMAT.save_plain(path, {"row": judged.row, "seed": judged.seed, "rooms": rooms})


def load_judged(path: Path) -> JudgedRow:
    """Read the verdicts; floating-point numbers are restored exactly.

    Raises:
        RecordError: The file is missing or damaged.
    """
    return FORMAT.load_plain(path, _judged)


def _judged(plain: dict[str, Any]) -> JudgedRow:
    return JudgedRow(
        row=plain["row"],
        seed=int(plain["seed"]),
        names=tuple(str(room["name"]) for room in plain["rooms"]),
        matches=tuple(_matches(room) for room in plain["rooms"]),
    )


def _plain(matches: SceneMatches) -> dict[str, Any]:
    return {
        "overlaps": list(matches.overlaps),
        "truth_counts": {str(label): count for label, count in matches.truth_counts.items()},
        "labels": matches.labels.tolist(),
        "overlap_idx": matches.overlap_idx.tolist(),
        "scores": matches.scores.tolist(),
        "correct": matches.correct.tolist(),
    }


def _matches(plain: dict[str, Any]) -> SceneMatches:
    return SceneMatches(
        overlaps=tuple(plain["overlaps"]),
        truth_counts={int(label): int(count) for label, count in plain["truth_counts"].items()},
        labels=np.array(plain["labels"], np.int64),
        overlap_idx=np.array(plain["overlap_idx"], np.int64),
        scores=np.array(plain["scores"], np.float64),
        correct=np.array(plain["correct"], np.bool_),
    )
