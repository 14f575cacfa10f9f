"""A scene of four parts far apart, each with its group of points and its true pose as the estimate."""

from functools import lru_cache
from typing import Any

import numpy as np

from binpick_env.evaluation.pose.record import DOUBT_COLUMNS, STAGES, VERDICT_COLUMNS, PoseRecord
from binpick_env.parts import load_part
from perception.geometry import Floats, make_transform, random_rotation, rotation_about
from perception.part import PartModel

EACH = 120  # points of a part
VISIBLE = (1.0, 0.6, 0.4, 0.2)


@lru_cache
def bracket() -> PartModel:
    return load_part("bracket").model


def moved(T_cam_part: Floats, share: float = 0.0, degrees: float = 0.0) -> Floats:
    """Return a pose shifted by a share of d_max and turned about the part's centre."""
    part = bracket()
    about = make_transform(rotation_about(np.array([1.0, 2.0, 3.0]), np.deg2rad(degrees)))
    there, back = make_transform(translation=part.centre), make_transform(translation=-part.centre)
    shift = make_transform(translation=[0.0, share * part.d_max, 0.0])
    return shift @ T_cam_part @ there @ about @ back


def record(**changes: Any) -> PoseRecord:
    """Return a scene in which everything was found, or what ``changes`` make of it."""
    rng, count = np.random.default_rng(3), len(VISIBLE)
    T = np.stack([make_transform(random_rotation(rng), [0.3 * k - 0.4, 0.0, 0.9]) for k in range(count)])
    ids = np.repeat(np.arange(count), EACH)
    values: dict[str, Any] = {
        "labels": ids,
        "confidences": np.ones(count),
        "explained": ids,
        "explained_confidences": np.ones(count),
        "instance_ids": ids,
        "visible_fractions": np.array(VISIBLE),
        "T_cam_parts": T,
        "trials": np.arange(3),
        "poses": T.copy(),
        "scores": np.array([0.9, 0.8, 0.7, 0.6]),
        "groups": np.arange(count),
        "estimated_fractions": np.array(VISIBLE),
        "verdicts": np.full((count, len(VERDICT_COLUMNS)), 0.5),
        "doubts": np.zeros((count, len(DOUBT_COLUMNS))),
        "verified": np.ones(count, np.bool_),
        "pixels": np.column_stack([np.arange(len(ids)) % 40, np.arange(len(ids)) // 40]),
        "picture": np.zeros((0, 0), np.uint8),
        "corner": (0, 0),
        "K": np.diag([1000.0, 1000.0, 1.0]),
        "whole_scene": False,
        "ms": dict(zip(STAGES, (1.0, 2.0, 3.0, 40.0, 30.0, 5.0, 46.0), strict=True)),
        "threads": 1,
        "git_commit": "abc",
    }
    return PoseRecord(**{**values, **changes})


def estimates(
    poses: Floats, scores: list[float], groups: list[int], verified: list[bool] | None = None
) -> dict[str, Any]:
    """Return the changes of a scene that make these its estimates."""
    count = len(scores)
    return {
        "poses": poses.reshape(-1, 4, 4),
        "scores": np.array(scores, np.float64),
        "groups": np.array(groups, np.int64),
        "estimated_fractions": np.ones(count),
        "verdicts": np.full((count, len(VERDICT_COLUMNS)), 0.5),
        "doubts": np.zeros((count, len(DOUBT_COLUMNS))),
        "verified": np.ones(count, np.bool_) if verified is None else np.array(verified),
    }
