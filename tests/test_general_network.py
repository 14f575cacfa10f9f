"""The shipped network for every part, on a part of a family that no training saw."""

import pytest

from binpick_env.parts.part import load_part
from binpick_env.scenes.synthesis import SceneConfig, make_scene
from perception.metrics.average_precision import ap_summary
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.scoring import score_scene
from perception.segmentation.weights import find_weights


@pytest.mark.slow
def test_the_shipped_network_separates_parts_of_a_family_that_no_training_saw() -> None:
    config = SceneConfig(part="generated:hollow_cap:50:50-110", seed=502, num_parts=(8, 8))
    scene, part = make_scene(config, 0).scene, load_part(config.part).model
    assert find_weights(part).training == "zero-shot"
    predictor = SegmentationPredictor.for_part(part, device="cpu")
    instances = predictor.predict(scene.boundary, scene.surface, scene.d_max)
    assert ap_summary([score_scene(scene, instances)]).ap75 > 0.9
