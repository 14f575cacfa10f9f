"""Predictions against a labelled scene: which ground truths count."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.instance import Instance
from perception.metrics.matching import SceneMatches, SceneTruth, match_scene
from perception.segmentation.scene import BoundaryScene

COUNTED_FROM = 0.1  # visible_fraction from which a part counts; hits on the others are ignored


def scene_truth(scene: BoundaryScene, visible: tuple[float, float] = (COUNTED_FROM, np.inf)) -> SceneTruth:
    """Return the ground truth; parts with a visible fraction outside [low, high) are ignored, container points void."""
    return truth_of(scene.instance_ids, scene.visible_fractions, visible)


def truth_of(
    instance_ids: NDArray[np.int64], fractions: Floats, visible: tuple[float, float] = (COUNTED_FROM, np.inf)
) -> SceneTruth:
    """Return the ground truth of (N,) points' parts and (P,) visible fractions; see `scene_truth`."""
    return SceneTruth(
        instance_ids=instance_ids,
        class_of_instance=np.zeros(len(fractions), np.int64),
        ignored=(fractions < visible[0]) | (fractions >= visible[1]),
    )


def score_scene(
    scene: BoundaryScene, instances: Sequence[Instance], visible: tuple[float, float] = (COUNTED_FROM, np.inf)
) -> SceneMatches:
    """Match instances with the scene's counted parts by ScanNet's rules, over every boundary point in the bin."""
    return match_scene(scene_truth(scene, visible), instances)
