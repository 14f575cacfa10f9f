"""The weights in the package find most parts of bins that were in no training."""

from pathlib import Path

import numpy as np
import pytest

from binpick_env.parts.part import load_part
from binpick_env.scenes.synthesis import SceneConfig, make_scene
from perception.metrics.average_precision import ap_summary
from perception.segmentation import weights
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.scoring import score_scene

UNSEEN = 987_654


@pytest.fixture(autouse=True)
def no_weights_of_the_users_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights, "user_folder", lambda: tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["part_a", "part_b", "part_c", "tee", "bracket"])
def test_most_parts_are_found(part: str) -> None:
    predictor = SegmentationPredictor.for_part(load_part(part).model, device="cpu")
    scene, _ = make_scene(SceneConfig(part=part, seed=UNSEEN), 0)
    instances = predictor.predict(scene.boundary, scene.surface, scene.d_max)
    assert all(0 <= instance.score <= 1 for instance in instances)
    assert ap_summary([score_scene(scene, instances)]).ap50 > 0.8


@pytest.mark.slow
def test_few_parts_are_found_as_well() -> None:
    predictor = SegmentationPredictor.for_part(load_part("tee").model, device="cpu")
    for count in (1, 3):
        scene, _ = make_scene(SceneConfig(part="tee", seed=UNSEEN, num_parts=(count, count)), 0)
        found = ap_summary([score_scene(scene, predictor.predict(scene.boundary, scene.surface, scene.d_max))])
        assert np.isnan(found.ap50) or found.ap50 > 0.5
    empty, _ = make_scene(SceneConfig(part="tee", seed=UNSEEN, num_parts=(0, 0)), 0)
    assert predictor.predict(empty.boundary, empty.surface, empty.d_max) == []
