"""Average precision over the twelve categories of Table 1, by the rules of ScanNet's benchmark."""

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from perception.instance import Instance
from perception.metrics.average_precision import ap_summary
from perception.metrics.matching import MIN_REGION, SceneMatches, SceneTruth, match_scene
from perception.runtime.file_work import InputWork, Run
from perception.s3dis.choices import Population
from perception.s3dis.data.blocks import BlockConfig, Ints, cover_room
from perception.s3dis.data.categories import CATEGORIES, SCORED
from perception.s3dis.data.room import Room

Predict = Callable[[Room, np.random.Generator], Sequence[Instance]]


@dataclass(frozen=True, kw_only=True)
class S3disScores:
    """Scores of a row of Table 1 in [0, 1]; NaN for a category without an object in any room.

    Attributes:
        ap50: Average precision at IoU 0.50 of each of the twelve categories.
        mean_ap50: Mean of ``ap50`` over the categories that occur.
        ap25: Mean over the categories of the average precision at IoU 0.25.
        ap: Mean over the categories of the average precision over IoU 0.50, 0.55 ... 0.90.
    """

    ap50: dict[str, float]
    mean_ap50: float
    ap25: float
    ap: float

    @classmethod
    def of(cls, matches: Sequence[SceneMatches]) -> "S3disScores":
        """Return the scores of all rooms pooled."""
        found = ap_summary(matches).per_class
        known = {name: found[CATEGORIES.index(name)] for name in SCORED if CATEGORIES.index(name) in found}
        return cls(
            ap50={name: known[name].ap50 if name in known else np.nan for name in SCORED},
            mean_ap50=_mean([scores.ap50 for scores in known.values()]),
            ap25=_mean([scores.ap25 for scores in known.values()]),
            ap=_mean([scores.ap for scores in known.values()]),
        )


def room_truth(room: Room) -> SceneTruth:
    """Return the ground truth of a room.

    Note:
        Clutter is a category like any other, so a chair predicted on clutter is wrong. Only the means leave it out.
    """
    categories = room.category_of_instance()
    return SceneTruth(
        instance_ids=room.instance.astype(np.int64),
        class_of_instance=categories,
        ignored=np.zeros(len(categories), np.bool_),
    )


def repeated(truth: SceneTruth, instances: Sequence[Instance], rows: Ints) -> tuple[SceneTruth, list[Instance]]:
    """Return truth and prediction over the points ``rows``, (R,) indices that name a point as often as it counts."""
    again = SceneTruth(
        instance_ids=truth.instance_ids[rows],
        class_of_instance=truth.class_of_instance,
        ignored=truth.ignored,
    )
    inside = np.zeros(len(truth.instance_ids), np.bool_)
    predicted = []
    for instance in instances:
        inside[instance.point_idx] = True
        idx = np.flatnonzero(inside[rows])
        predicted.append(Instance(point_idx=idx, score=instance.score, label=instance.label))
        inside[instance.point_idx] = False
    return again, predicted


def room_rng(name: str, seed: int) -> np.random.Generator:
    """Return the random generator of a room, which depends on its name and the seed alone."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(name.encode())]))


def match_room(
    predict: Predict,
    room: Room,
    population: Population = "room",
    blocks: BlockConfig | None = None,
    seed: int = 0,
) -> SceneMatches:
    """Match the prediction of a room with its truth.

    Args:
        predict: Returns the objects of a room, given its random generator.
        room: Room to predict.
        population: Points that count: each point of the room once (``room``), or the points of the samples of all
            blocks as in the released code (``blocks``), where a point in the middle of the room counts four times.
        blocks: Division into blocks for the population ``blocks``.
        seed: Seed of the random generator, the same for prediction and population.

    Raises:
        ValueError: There is no such population.
    """
    if population not in ("room", "blocks"):
        raise ValueError(f"population must be 'room' or 'blocks', got {population!r}")
    truth, instances = room_truth(room), predict(room, room_rng(room.name, seed))
    if population == "blocks":
        samples = cover_room(room.xyz, blocks or BlockConfig(), room_rng(room.name, seed))
        truth, instances = repeated(truth, instances, np.concatenate([sample.point_idx for sample in samples]))
    return match_scene(truth, instances, min_region=MIN_REGION)


def match_rooms(
    predict: Predict,
    paths: Sequence[Path],
    run: Run[SceneMatches] = map,
    population: Population = "room",
    seed: int = 0,
) -> Iterator[SceneMatches]:
    """Match the predictions of rooms with their truth.

    Args:
        predict: Returns the objects of a room, given its random generator.
        paths: Files of the rooms.
        run: Maps work over the indices of the rooms, each of which reads its file.
        population: Points that count, see :func:`match_room`.
        seed: Seed of the random generators of the rooms.

    Raises:
        RoomError: A file does not hold a complete room.
    """
    match = partial(_match_file, predict, tuple(paths), population, seed)
    return iter(run(InputWork(match, {k: [path] for k, path in enumerate(paths)}), range(len(paths))))


def _match_file(predict: Predict, paths: Sequence[Path], population: Population, seed: int, index: int) -> SceneMatches:
    return match_room(predict, Room.load(paths[index]), population, seed=seed)


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else np.nan
