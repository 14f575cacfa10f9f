"""Arrays in, instances out: all points of a frame, in whatever order, and bad input."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from perception.instance import labels_of
from perception.metrics.average_precision import ap_summary
from perception.part import PartModel
from perception.segmentation.grouping.similarity import GroupingConfig
from perception.segmentation.networks.context_net import ContextNetConfig
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.networks.output import PointOutputs
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.predictor import PredictorConfig, SegmentationPredictor
from perception.segmentation.scoring import score_scene
from perception.segmentation.surface import Surface
from perception.segmentation.weights import GENERAL, SHIPPED, NetworkConfig, build_network, weights_name
from perception.shape import shape_signature, shape_values
from tests.perception.disc_scene import D_MAX, disc_scene

SMALL = GridNetConfig(widths=(4, 5, 6, 7, 8), hidden=9, embedding=3)
CLOUD = SgpnConfig(trunk="dgcnn", k=4, global_width=8, embedding=5, branch=6)


CONTEXT = ContextNetConfig(k=4, edge_k=3, edge=5, widths=(6, 7, 8), depths=(1, 1, 1), branch=9, embedding=4)
EVERY = pytest.mark.parametrize("config", [SMALL, CLOUD, CONTEXT], ids=["grid", "cloud", "context"])


def predictor(config: NetworkConfig, **settings: object) -> SegmentationPredictor:
    torch.manual_seed(0)
    return SegmentationPredictor(build_network(config), PredictorConfig(**settings), device="cpu")


def test_votes_that_meet_at_the_centres_are_the_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = disc_scene(points_each=200)
    teller = predictor(SMALL, grouping=GroupingConfig(min_points=20))

    def perfect(inputs) -> PointOutputs:
        ids = torch.from_numpy(scene.instance_ids)
        votes = torch.from_numpy(scene.centres_cam / D_MAX)[ids].float()
        votes[ids < 0] = inputs.points_BN3[0, ids < 0] + 40.0
        confidence = torch.full(ids.shape, 0.9)
        return PointOutputs(50 * votes[None], confidence[None], torch.zeros(1, len(ids), 1), votes[None])

    monkeypatch.setattr(teller, "network", perfect)
    monkeypatch.setattr("perception.segmentation.predictor.GridNet", type(perfect))
    instances = teller.predict(scene.boundary, scene.surface, scene.d_max)
    assert ap_summary([score_scene(scene, instances)]).ap == 1.0
    assert [round(instance.score, 3) for instance in instances][: len(scene.centres_cam)] == [0.9] * 6


def test_the_shipped_network_over_points_separates_discs() -> None:
    scene = disc_scene()
    teller = SegmentationPredictor.from_file(
        SHIPPED / f"{weights_name(GENERAL, 'dgcnn-context')}.safetensors", device="cpu"
    )
    instances = teller.predict(scene.boundary.points_cam, d_max=scene.d_max)
    assert ap_summary([score_scene(scene, instances)]).ap50 > 0.9


@EVERY
def test_every_point_is_described_and_a_second_look_says_the_same(config: NetworkConfig) -> None:
    scene, teller = disc_scene(), predictor(config, subset=300)
    said = teller.describe(scene.boundary, scene.surface, scene.d_max)
    assert len(said.embedding) == len(said.confidence) == len(scene.boundary)
    assert np.isfinite(said.embedding).all()
    again = teller.describe(scene.boundary, scene.surface, scene.d_max)
    np.testing.assert_array_equal(said.embedding, again.embedding)


def test_the_order_of_the_points_changes_nothing() -> None:
    scene, teller = disc_scene(), predictor(SMALL, bf16=False)
    order = np.random.default_rng(0).permutation(len(scene.boundary))
    straight = labels_of(teller.predict(scene.boundary, scene.surface, D_MAX), len(order))
    mixed = labels_of(teller.predict(scene.boundary.only(order), scene.surface, D_MAX), len(order))
    np.testing.assert_array_equal(straight[order], mixed)


def test_subsets_cover_the_cloud_evenly() -> None:
    scene, teller = disc_scene(), predictor(CLOUD, subset=300)
    sizes: list[int] = []
    forward = teller.network.forward
    teller.network.forward = lambda points: (sizes.append(points.shape[1]), forward(points))[1]  # type: ignore[method-assign]
    teller.describe(scene.boundary, scene.surface, D_MAX)
    assert sum(sizes) == len(scene.boundary) == 980
    assert sizes == [245] * 4


@EVERY
def test_too_few_points_have_no_instances(config: NetworkConfig) -> None:
    scene, teller = disc_scene(), predictor(config)
    for count in (0, 1, 3):
        few = scene.only(np.arange(len(scene.boundary)) < count)
        assert teller.predict(few.boundary, scene.surface, D_MAX) == []


@pytest.mark.parametrize("config", [CLOUD, CONTEXT], ids=["cloud", "context"])
def test_points_alone_are_segmented_as_the_cloud_is(config: NetworkConfig) -> None:
    scene, teller = disc_scene(), predictor(config, grouping=GroupingConfig(min_points=5))
    assert not teller.needs_surface
    alone = teller.predict(scene.boundary.points_cam, d_max=D_MAX)
    with_surface = teller.predict(scene.boundary, scene.surface, D_MAX)
    assert len(alone) > 0
    for mine, other in zip(alone, with_surface, strict=True):
        np.testing.assert_array_equal(mine.point_idx, other.point_idx)


def test_the_image_plane_network_refuses_points_alone_and_surfaces_without_depth() -> None:
    scene, teller = disc_scene(), predictor(SMALL)
    assert teller.needs_surface
    with pytest.raises(ValueError, match="needs the pixels and the surface of a frame, got points and no surface"):
        teller.predict(scene.boundary.points_cam, d_max=D_MAX)
    with pytest.raises(ValueError, match="got a BoundaryCloud and no surface"):
        teller.predict(scene.boundary, d_max=D_MAX)
    for depth in (np.zeros((0, 0), np.float32), np.zeros_like(scene.surface.depth)):
        empty = Surface(depth=depth, u0=0.0, v0=0.0, cell=scene.surface.cell)
        with pytest.raises(ValueError, match="surface must have depths where the boundary points are"):
            teller.predict(scene.boundary, empty, D_MAX)


def test_points_that_are_none_are_named() -> None:
    teller = predictor(CONTEXT)
    with pytest.raises(ValueError, match=r"points must be \(N, 3\), got \(4, 2\)"):
        teller.predict(np.zeros((4, 2)), d_max=D_MAX)
    with pytest.raises(ValueError, match="points must be finite, point 1 is"):
        teller.predict(np.array([[0.0, 0, 0], [np.nan, 0, 0]]), d_max=D_MAX)
    with pytest.raises(ValueError, match="d_max must be positive and finite, got None"):
        teller.predict(np.zeros((4, 3)))


def test_one_giant_instance_is_cut_to_the_parts_size() -> None:
    scene = disc_scene(parts=1, points_each=900, void=0)
    # To the network, all points are one.
    teller = predictor(SMALL, grouping=GroupingConfig(threshold=1e6, min_points=20))
    instances = teller.predict(scene.boundary, scene.surface, D_MAX / 4)  # a model of a quarter of the true size
    assert instances
    for instance in instances:
        points = scene.boundary.points_cam[instance.point_idx]
        assert np.ptp(points, axis=0).max() < D_MAX / 4 * 1.1


def test_the_network_is_told_the_shape_of_the_predictors_part_or_the_given_one() -> None:
    torch.manual_seed(0)
    network, scene = GridNet(replace(SMALL, shape=True)), disc_scene()
    for layer in network.shape:
        torch.nn.init.normal_(layer.weight)
    part = PartModel.from_mesh("rod", trimesh.creation.box((0.1, 0.01, 0.01)))
    told, untold = SegmentationPredictor(network, part=part), SegmentationPredictor(network)
    of_part = told.describe(scene.boundary, scene.surface, scene.d_max).embedding
    given = untold.describe(scene.boundary, scene.surface, scene.d_max, shape_values(shape_signature(part)))
    np.testing.assert_array_equal(of_part, given.embedding)
    assert np.abs(of_part - untold.describe(scene.boundary, scene.surface, scene.d_max).embedding).max() > 0.1


def test_nonsense_is_named() -> None:
    scene, teller = disc_scene(), predictor(SMALL)
    for size in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="d_max must be positive and finite"):
            teller.predict(scene.boundary, scene.surface, size)
    with pytest.raises(ValueError, match="subset must be at least 1, got 0"):
        PredictorConfig(subset=0)
    with pytest.raises(ValueError, match="points_cam must be finite"):
        replace(scene.boundary, points_cam=np.full((len(scene.boundary), 3), np.nan))
