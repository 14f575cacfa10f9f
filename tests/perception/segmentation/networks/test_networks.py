"""PointNet and DGCNN trunks, their graphs, and SGPN's heads."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from perception.segmentation.networks import dgcnn
from perception.segmentation.networks.dgcnn import DgcnnConfig, DGCNNTrunk, EdgeConv, dense_neighbours, tree_neighbours
from perception.segmentation.networks.pointnet import PointNetConfig, PointNetTrunk, SharedLayerWithCloud
from perception.segmentation.networks.sgpn import Sgpn, SgpnConfig, similarity_matrix

TWIN = runpy.run_path(str(Path(__file__).parents[3] / "reference" / "dgcnn_twin.py"))
SMALL = DgcnnConfig(k=5, edge_widths=((8, 6), (7, 6), (5,)), global_width=12, head_widths=(10, 9))


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def seeded(build, seed: int = 0):
    """Build a network whose normalisation is no identity: uneven statistics, scales of both signs, and shifts."""
    torch.manual_seed(seed)
    network = build()
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.normal_(module.running_mean, 0.0, 0.2)
            nn.init.uniform_(module.running_var, 0.01, 0.1)  # the sums' own, so that differences survive all layers
            nn.init.uniform_(module.weight, -1.5, 1.5)
            nn.init.normal_(module.bias, 0.0, 0.3)
    return network.eval()


def cloud_batch(batch: int, count: int, channels: int = 3, seed: int = 1, dtype=torch.float32) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(batch, count, channels))).to(dtype)


def gradients(network: nn.Module, points: Tensor, features: Tensor) -> list[Tensor]:
    weights = torch.linspace(-1.0, 1.0, features.numel(), dtype=features.dtype).view_as(features)
    return list(torch.autograd.grad((weights * features.square()).sum(), [points, *network.parameters()]))


def assert_equals_twin(config: DgcnnConfig, points: Tensor, tolerance: float, training: bool = False) -> None:
    trunk = seeded(lambda: DGCNNTrunk(config)).to(points.dtype).train(training)
    points.requires_grad_()
    features = trunk(points)
    twin = TWIN["dgcnn"](trunk, points, config.k, config.graph_channels, config.reuse_graph)
    torch.testing.assert_close(features, twin, atol=tolerance, rtol=tolerance)
    for fast, naive in zip(gradients(trunk, points, features), gradients(trunk, points, twin), strict=True):
        torch.testing.assert_close(fast, naive, atol=tolerance * float(1 + naive.abs().max()), rtol=tolerance)


@pytest.mark.parametrize("training", [False, True])
@pytest.mark.parametrize("reuse_graph", [False, True])
def test_dgcnn_and_its_gradients_equal_the_naive_twin(reuse_graph: bool, training: bool) -> None:
    config = replace(SMALL, reuse_graph=reuse_graph)
    assert_equals_twin(config, cloud_batch(2, 18, dtype=torch.float64), 1e-10, training)


def test_dgcnn_in_single_precision_equals_the_naive_twin() -> None:
    assert_equals_twin(SMALL, cloud_batch(2, 18), 1e-5)


def test_dgcnn_of_nine_coordinates_builds_its_graph_on_those_named() -> None:
    points = cloud_batch(1, 18, 9, dtype=torch.float64)
    for graph_channels in ((0, 1, 2), (6, 7, 8), tuple(range(9))):
        config = replace(SMALL, in_channels=9, graph_channels=graph_channels)
        assert_equals_twin(config, points.clone(), 1e-10)


def test_reusing_the_graph_changes_the_features() -> None:
    points = cloud_batch(1, 40)
    dynamic, static = (seeded(lambda r=r: DGCNNTrunk(replace(SMALL, reuse_graph=r)))(points) for r in (False, True))
    assert (dynamic - static).abs().max() > 0.1


def test_an_edge_conv_of_three_points_by_hand() -> None:
    conv = EdgeConv(1, (1,)).eval()
    with torch.no_grad():
        conv.first.linear.weight.copy_(torch.tensor([[1.0, 10.0]]))  # x_i + 10 (x_j - x_i)
    conv.first.norm.eps = 0.0
    x = torch.tensor([[[0.0], [1.0], [3.0]]])
    graph = torch.tensor([[[0, 1], [1, 0], [2, 1]]])  # itself and the nearest other
    # Edges of 0: 0 and 10; of 1: 1 and 1 - 10; of 3: 3 and 3 - 20.
    torch.testing.assert_close(conv(x, graph), torch.tensor([[[10.0], [1.0], [3.0]]]))
    torch.testing.assert_close(conv(x, graph[..., 1:]), torch.tensor([[[10.0], [-1.8], [-3.4]]]))  # slope 0.2


@pytest.mark.parametrize("k", [1, 7, 20])
@pytest.mark.parametrize("find", [tree_neighbours, dense_neighbours])
def test_graphs_hold_the_nearest_points_and_the_point_itself(find, k: int) -> None:
    points = cloud_batch(2, 50, dtype=torch.float64)
    graph = find(points, k)
    assert graph.shape == (2, 50, k)
    assert graph.dtype == torch.int64
    for cloud, found in zip(points, graph, strict=True):
        assert [set(row) for row in found.tolist()] == [set(row) for row in TWIN["nearest"](cloud, k)]


@pytest.mark.parametrize("find", [tree_neighbours, dense_neighbours])
def test_graphs_of_a_grid_with_ties_have_the_nearest_distances(find) -> None:
    cloud = torch.cartesian_prod(*[torch.arange(4.0)] * 3)
    cloud = torch.cat([cloud, cloud[:9]])  # and points that coincide
    found = (cloud[find(cloud[None], 9)[0]] - cloud[:, None]).norm(dim=-1).sort(dim=1)[0]
    torch.testing.assert_close(found, torch.cdist(cloud, cloud).sort(dim=1)[0][:, :9], atol=1e-5, rtol=0.0)


def test_dense_neighbours_are_the_same_in_chunks_and_far_from_the_origin(monkeypatch) -> None:
    points = cloud_batch(2, 60, 16)
    whole = dense_neighbours(points, 6).sort(dim=-1)[0]
    monkeypatch.setattr(dgcnn, "CHUNK_CPU", 7 * 60)
    assert torch.equal(dense_neighbours(points, 6).sort(dim=-1)[0], whole)
    monkeypatch.setattr(dgcnn, "CHUNK_CPU", 1)
    assert torch.equal(dense_neighbours(points + 1000.0, 6).sort(dim=-1)[0], whole)


def test_no_gradient_flows_through_the_graph() -> None:
    points = cloud_batch(1, 12).requires_grad_()
    assert not dense_neighbours(points, 3).requires_grad
    assert not tree_neighbours(points, 3).requires_grad


def test_the_first_graph_in_space_is_the_trees_and_in_nine_coordinates_dense(monkeypatch) -> None:
    called = []
    for name in ("tree_neighbours", "dense_neighbours"):
        find = getattr(dgcnn, name)
        monkeypatch.setattr(dgcnn, name, lambda x, k, name=name, find=find: called.append((name, k)) or find(x, k))
    DGCNNTrunk(SMALL).eval()(cloud_batch(1, 12))
    DGCNNTrunk(replace(SMALL, in_channels=9, graph_channels=tuple(range(9)), reuse_graph=True)).eval()(
        cloud_batch(1, 12, 9)
    )
    assert called == [("tree_neighbours", 5), ("dense_neighbours", 5), ("dense_neighbours", 5), ("dense_neighbours", 5)]


@pytest.mark.parametrize("count", [1, 2, 4])
def test_clouds_smaller_than_k_have_all_points_as_neighbours(count: int) -> None:
    points = cloud_batch(2, count, dtype=torch.float64)
    assert tree_neighbours(points, 5).shape == dense_neighbours(points, 5).shape == (2, count, count)
    assert_equals_twin(SMALL, points, 1e-10)


def test_pointnet_equals_the_tiled_and_concatenated_layout() -> None:
    config = PointNetConfig(widths=(6, 7), cloud_widths=(8, 5), head_widths=(9, 4))
    trunk = seeded(lambda: PointNetTrunk(config))
    points = cloud_batch(3, 11)
    rows = points.flatten(0, 1)
    for layer in trunk.points:
        rows = TWIN["shared"](layer, rows, 0.0)
    clouds = rows.view(3, 11, -1).amax(1)
    for layer in trunk.cloud:
        clouds = TWIN["shared"](layer, clouds, 0.0)
    rows = torch.cat([rows, clouds.repeat_interleave(11, dim=0)], dim=-1)
    for layer in (trunk.join, *trunk.head):
        rows = TWIN["shared"](layer, rows, 0.0)
    torch.testing.assert_close(trunk(points), rows.view(3, 11, 4), atol=1e-5, rtol=1e-5)


def test_trunks_have_the_published_sizes() -> None:
    for trunk in (PointNetTrunk(), DGCNNTrunk()):
        assert trunk.width == 256
        assert trunk.eval()(cloud_batch(1, 25)).shape == (1, 25, 256)
    shapes = [tuple(p.shape) for name, p in PointNetTrunk().named_parameters() if "linear" in name]
    points, cloud = [(64, 3), (64, 64), (64, 64), (128, 64), (1024, 128)], [(256, 1024), (128, 256)]
    assert shapes == [*points, *cloud, (512, 1024 + 128), (256, 512)]
    shapes = [tuple(p.shape) for name, p in DGCNNTrunk().named_parameters() if "linear" in name]
    edges = [(64, 6), (64, 64), (64, 128), (64, 64), (64, 128)]
    assert shapes == [*edges, (1024, 192), (512, 192 + 1024), (256, 512)]


@pytest.mark.parametrize("trunk", ["pointnet", "dgcnn"])
def test_points_in_another_order_get_the_same_outputs(trunk: str) -> None:
    network = seeded(lambda: Sgpn(SgpnConfig(trunk=trunk, k=6, global_width=32))).double()
    points = cloud_batch(2, 30, dtype=torch.float64)
    order = torch.randperm(30, generator=torch.Generator().manual_seed(3))
    outputs, permuted = network(points), network(points[:, order])
    for before, after in zip(outputs[:3], permuted[:3], strict=True):
        torch.testing.assert_close(after, before[:, order])
        assert (after - before).abs().max() > 1e-2


@pytest.mark.parametrize("trunk", ["pointnet", "dgcnn"])
def test_clouds_of_a_batch_do_not_see_each_other_in_evaluation(trunk: str) -> None:
    network = seeded(lambda: Sgpn(SgpnConfig(trunk=trunk, k=6, global_width=32))).double()
    points = cloud_batch(3, 20, dtype=torch.float64)
    together = network(points)
    for b in range(3):
        for whole, alone in zip(together[:3], network(points[b : b + 1])[:3], strict=True):
            torch.testing.assert_close(whole[b : b + 1], alone)


@pytest.mark.parametrize("trunk", ["pointnet", "dgcnn"])
@pytest.mark.parametrize(("channels", "classes"), [(3, 1), (9, 13)])
def test_sgpn_outputs_and_a_step_of_training(trunk: str, channels: int, classes: int) -> None:
    torch.manual_seed(0)
    config = SgpnConfig(trunk=trunk, in_channels=channels, num_classes=classes, global_width=64, embedding=12)
    network = Sgpn(config)
    outputs = network(cloud_batch(2, 25, channels))
    assert outputs.embedding_BNF.shape == (2, 25, 12)
    assert outputs.embedding_BNF.min() == 0  # a ReLU closes the branch
    assert outputs.confidence_BN.shape == (2, 25)
    assert ((outputs.confidence_BN > 0) & (outputs.confidence_BN < 1)).all()
    assert outputs.semantics_BNS.shape == (2, 25, classes)
    assert outputs.semantics_BNS.min() < 0  # logits
    assert outputs.offsets_BN3 is None
    sum(output.sum() for output in outputs[:3]).backward()
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in network.parameters())


def test_every_sgpn_field_arrives_in_the_network() -> None:
    config = SgpnConfig(
        in_channels=9,
        num_classes=4,
        embedding=6,
        branch=7,
        k=3,
        global_width=33,
        graph_channels=(6, 7, 8),
        reuse_graph=True,
    )
    network = Sgpn(config)
    assert network.trunk.config == DgcnnConfig(
        in_channels=9, k=3, global_width=33, graph_channels=(6, 7, 8), reuse_graph=True
    )
    assert [p.shape[0] for p in network.similarity.parameters()] == [6, 6]
    assert [p.shape[0] for p in network.confidence.parameters()] == [7, 7, 1, 1]
    assert [p.shape[0] for p in network.semantics.parameters()] == [7, 7, 4, 4]
    pointnet = Sgpn(SgpnConfig(trunk="pointnet", in_channels=9, global_width=33)).trunk
    assert pointnet.config == PointNetConfig(in_channels=9, widths=(64, 64, 64, 128, 33))
    assert Sgpn().config == SgpnConfig()


def test_weights_survive_their_state_dict() -> None:
    config = SgpnConfig(k=4, global_width=16)
    first, second = seeded(lambda: Sgpn(config), 0), seeded(lambda: Sgpn(config), 1)
    points = cloud_batch(1, 15)
    assert not torch.equal(first(points).embedding_BNF, second(points).embedding_BNF)
    second.load_state_dict(first.state_dict())
    assert torch.equal(first(points).embedding_BNF, second(points).embedding_BNF)


def test_autocast_keeps_the_graph_and_the_outputs_in_single_precision() -> None:
    # The graph stays the first one: among features rounded to bfloat16 other points may well be nearest.
    network = seeded(lambda: Sgpn(SgpnConfig(k=6, global_width=32, reuse_graph=True)))
    points = cloud_batch(2, 30)
    with torch.no_grad():
        exact = network(points)
    with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
        outputs = network(points)
        assert torch.equal(dense_neighbours(points, 6).sort(-1)[0], tree_neighbours(points, 6).sort(-1)[0])
    for rough, fine in zip(outputs[:3], exact[:3], strict=True):
        assert rough.dtype == torch.float32
        torch.testing.assert_close(rough, fine, atol=0.1 * float(fine.abs().max()), rtol=0.0)


def test_edges_between_near_points_survive_autocast_far_from_the_origin() -> None:
    conv = EdgeConv(3, (4,)).eval()
    with torch.no_grad():
        conv.first.linear.weight[:, :3] = 0.0  # only offsets count
    points = 1e-3 * cloud_batch(1, 10)
    graph = tree_neighbours(points, 4)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        near, far = conv(points, graph), conv(points + 1.0, graph)
    torch.testing.assert_close(far, near, atol=1e-6, rtol=0.0)  # rounding at 1 to 8 bits would lose 4e-3
    assert near.abs().max() > 3e-4


def test_similarity_matrix_of_a_right_triangle() -> None:
    embedding = torch.tensor([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    lengths = torch.tensor([[0.0, 3.0, 4.0], [3.0, 0.0, 5.0], [4.0, 5.0, 0.0]])
    torch.testing.assert_close(similarity_matrix(embedding), lengths)
    torch.testing.assert_close(similarity_matrix(embedding[None], "scaled_square"), 10 * lengths[None].square())


def test_similarity_of_near_points_far_from_the_origin_does_not_cancel() -> None:
    embedding = 300.0 + cloud_batch(1, 40, 5) / 100
    exact = torch.cdist(embedding.double(), embedding.double()).float()
    torch.testing.assert_close(similarity_matrix(embedding), exact, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("distance", ["l2", "scaled_square"])
def test_similarity_of_coinciding_points_is_zero_with_a_finite_gradient(distance: str) -> None:
    embedding = cloud_batch(1, 1, 5).expand(1, 40, 5).clone().add_(100.0).requires_grad_()
    matrix = similarity_matrix(embedding, distance)
    assert matrix.abs().max() == 0
    matrix.sum().backward()
    assert torch.equal(embedding.grad, torch.zeros_like(embedding))


def test_similarity_matrix_names_the_distances_that_exist() -> None:
    with pytest.raises(ValueError, match=r"distance must be one of \('l2', 'scaled_square'\), got 'cosine'"):
        similarity_matrix(torch.zeros(2, 3), "cosine")


@pytest.mark.parametrize("trunk", ["pointnet", "dgcnn"])
@pytest.mark.parametrize("shape", [(2, 10, 9), (10, 3), (2, 0, 3), (0, 10, 3)])
def test_points_that_do_not_fit_are_refused(trunk: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"points_BNC must be \(B, N, 3\) with B and N at least 1, got \(\d+, \d+"):
        Sgpn(SgpnConfig(trunk=trunk, global_width=8)).eval()(torch.zeros(shape))


def test_pointnet_refuses_to_train_on_a_single_cloud_and_dgcnn_does_not() -> None:
    with pytest.raises(ValueError, match="points_BNC must hold at least 2 clouds in training"):
        PointNetTrunk(PointNetConfig(widths=(4,))).train()(cloud_batch(1, 10))
    assert DGCNNTrunk(SMALL).train()(cloud_batch(1, 10)).shape == (1, 10, 9)


def test_a_layer_with_cloud_refuses_points_alone() -> None:
    with pytest.raises(ValueError, match="cloud_BG must be given beside features_BNC"):
        SharedLayerWithCloud(3, 4, 5)(torch.zeros(1, 2, 3))


@pytest.mark.parametrize(
    ("config", "field", "value"),
    [
        (DgcnnConfig, "k", 0),
        (DgcnnConfig, "in_channels", 0),
        (DgcnnConfig, "global_width", -1),
        (DgcnnConfig, "edge_widths", ()),
        (DgcnnConfig, "edge_widths", ((64, 0),)),
        (DgcnnConfig, "edge_widths", ((64,), ())),
        (DgcnnConfig, "head_widths", (256,)),
        (DgcnnConfig, "head_widths", (256, 0)),
        (DgcnnConfig, "graph_channels", (0, 1, 3)),
        (DgcnnConfig, "graph_channels", (-1,)),
        (DgcnnConfig, "graph_channels", ()),
        (PointNetConfig, "in_channels", 0),
        (PointNetConfig, "widths", ()),
        (PointNetConfig, "cloud_widths", (256, 0)),
        (PointNetConfig, "head_widths", ()),
        (SgpnConfig, "trunk", "pointnet++"),
        (SgpnConfig, "num_classes", 0),
        (SgpnConfig, "embedding", 0),
        (SgpnConfig, "branch", 0),
        (SgpnConfig, "k", 0),
        (SgpnConfig, "graph_channels", (6, 7, 8)),
    ],
)
def test_configs_refuse_nonsense_and_name_it(config: type, field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"^{field} must ") as raised:
        config(**{field: value})
    assert str(raised.value).endswith(f"got {value!r}")
