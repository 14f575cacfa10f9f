"""Scores of predicted instances against a labelled scene."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.instance import Instance
from perception.metrics.matching import SceneMatches, SceneTruth, match_scene
from perception.segmentation.scene import BoundaryScene

COUNTED_FROM = 0.1  # visible fraction from which on a part counts; predictions on other parts are ignored


def scene_truth(scene: BoundaryScene, visible: tuple[float, float] = (COUNTED_FROM, np.inf)) -> SceneTruth:
    """Return the ground truth of a scene; points of the container are void.

    Args:
        scene: Labelled scene.
        visible: Visible fractions [low, high) of the parts that count; other parts are ignored.
    """
    return truth_of(scene.instance_ids, scene.visible_fractions, visible)


def truth_of(
    instance_ids: NDArray[np.int64], fractions: Floats, visible: tuple[float, float] = (COUNTED_FROM, np.inf)
) -> SceneTruth:
    """Return the ground truth of a scene.

    Args:
        instance_ids: (N,) part that each point lies on, -1 for the container.
        fractions: (P,) visible fraction of each part.
        visible: Visible fractions [low, high) of the parts that count; other parts are ignored.
    """
    return SceneTruth(
        instance_ids=instance_ids,
        class_of_instance=np.zeros(len(fractions), np.int64),
        ignored=(fractions < visible[0]) | (fractions >= visible[1]),
    )


def score_scene(
    scene: BoundaryScene, instances: Sequence[Instance], visible: tuple[float, float] = (COUNTED_FROM, np.inf)
) -> SceneMatches:
    """Match instances with the parts of a scene that count, by ScanNet's rules, over all boundary points in the bin.

    Args:
        scene: Labelled scene.
        instances: Predicted instances.
        visible: Visible fractions [low, high) of the parts that count; other parts are ignored.
    """
    return match_scene(scene_truth(scene, visible), instances)
