"""Every method labels all points, and its settings take effect."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from binpick_env.evaluation.segmentation.method import MethodConfig, Segmenter, segmenter, trained_distance
from binpick_env.scenes.synthesis import make_scene
from perception.boundary import BoundaryCloud
from perception.instance import labels_of
from perception.segmentation.weights import save_network
from tests.binpick_env.evaluation.segmentation.small_evaluation import SCENES, tiny_grid


def no_points() -> BoundaryCloud:
    return BoundaryCloud(
        points_cam=np.zeros((0, 3)),
        tangents_cam=np.zeros((0, 3)),
        linearity=np.zeros(0),
        pixels=np.zeros((0, 2), np.int64),
    )


def test_every_method_labels_the_same_points(weights: Path, sgpn_weights: Path) -> None:
    scene = make_scene(SCENES, 0).scene
    methods = [
        MethodConfig(weights=weights),
        MethodConfig(weights=weights, mask=False, threshold=100.0),
        MethodConfig(weights=sgpn_weights, subset=500),
        MethodConfig(weights=sgpn_weights, grouping="merging", subset=500, threshold=1.0),
        MethodConfig(kind="euclidean", radius=0.004),
    ]
    for method in methods:
        instances = Segmenter(method).segment(scene.boundary, scene.surface, scene.d_max)
        labels = labels_of(instances, len(scene.boundary))
        np.testing.assert_array_equal(np.unique(labels[labels >= 0]), np.arange(len(instances)))
        assert min((i.score for i in instances), default=0.0) >= 0
        assert Segmenter(method).segment(no_points(), scene.surface, scene.d_max) == []


def test_the_distance_mask_limits_the_extent_of_groups(weights: Path, sgpn_weights: Path) -> None:
    scene = make_scene(SCENES, 0).scene

    def widest(method: MethodConfig) -> float:
        instances = Segmenter(method).segment(scene.boundary, scene.surface, scene.d_max)
        points = [scene.boundary.points_cam[i.point_idx] for i in instances]
        return max(float(np.linalg.norm(p - p[0], axis=1).max()) for p in points) / scene.d_max

    for file, grouping in ((weights, "ours"), (sgpn_weights, "ours")):
        loose = MethodConfig(weights=file, grouping=grouping, mask=False, threshold=1e6)  # type: ignore[arg-type]
        assert widest(loose) > 1.2
        assert widest(replace(loose, mask=True)) < 1.05


def test_several_grouping_distances_give_the_same_as_one_by_one(weights: Path) -> None:
    scene = make_scene(SCENES, 0).scene
    for method, settings in (
        (MethodConfig(weights=weights), (1.0, 7.5)),
        (MethodConfig(kind="euclidean"), (0.002, 0.01)),
    ):
        together = Segmenter(method).segment_at(settings, scene.boundary, scene.surface, scene.d_max)
        for setting, instances in zip(settings, together, strict=True):
            assert method.with_grouping_distance(setting).grouping_distance == setting
            alone = Segmenter(method.with_grouping_distance(setting)).segment(
                scene.boundary, scene.surface, scene.d_max
            )
            assert [i.point_idx.tolist() for i in alone] == [i.point_idx.tolist() for i in instances]
    assert MethodConfig(weights=weights).grouping_distance == 9.0


def test_a_network_is_cached_until_its_weights_change(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save_network(path, tiny_grid(), {})
    method = MethodConfig(weights=path)
    first = segmenter(method)
    assert segmenter(method) is first
    other = tiny_grid()
    torch.nn.init.zeros_(other.offset.weight)
    save_network(path, other, {})
    assert segmenter(method) is not first


def test_the_embeddings_distance_is_that_of_the_training() -> None:
    assert trained_distance({"training": {"pairs": {"distance": "scaled_square"}}}) == "scaled_square"
    assert trained_distance({}) == trained_distance({"training": {"pairs": {"distance": "l2"}}}) == "l2"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"kind": "magic"}, "kind must be one of network, euclidean, got 'magic'"),
        ({"grouping": "magic"}, "grouping must be one of ours, merging, got 'magic'"),
        ({}, "kind 'network' needs weights, got None"),
        ({"kind": "euclidean", "radius": 0.0}, "radius must be positive, got 0.0"),
        ({"kind": "euclidean", "threshold": -1.0}, "threshold must be positive, got -1.0"),
    ],
)
def test_nonsense_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        MethodConfig(**changes)
