"""The context network: its levels, what a shift or the order of a cloud changes, and the compiled maximum."""

import copy

import numpy as np
import pytest
import torch

from perception.segmentation.networks import _kernels
from perception.segmentation.networks.context_net import (
    ContextInputs,
    ContextNet,
    ContextNetConfig,
    OffsetConv,
    interpolate,
    neighbour_max,
)
from perception.segmentation.networks.dgcnn import gather_neighbours
from perception.segmentation.networks.hierarchy import build_hierarchy, level_order, level_sizes, thin, window

SMALL = ContextNetConfig(k=6, edge_k=4, edge=5, widths=(6, 7, 8), depths=(1, 1, 1), branch=9, embedding=4)


def cloud(count: int = 200, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.0, 2.0, (count, 3))


def network(config: ContextNetConfig = SMALL) -> ContextNet:
    torch.manual_seed(0)
    return ContextNet(config).eval()


def inputs(*clouds: np.ndarray, k: int = 6) -> ContextInputs:
    return ContextInputs.of([build_hierarchy(points, k) for points in clouds])


def test_thinning_leaves_one_point_in_each_cube() -> None:
    points = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.02, 0, 0], [0.5, 0, 0], [0.5, 0.5, 0]])
    chosen = thin(points, 0.1, np.random.default_rng(0))
    assert len(chosen) == 3
    assert {3, 4} < set(chosen.tolist())


def test_the_first_quarter_is_spread_over_the_cloud() -> None:
    dense = np.column_stack([np.repeat(np.arange(10) * 1.0, 30), *np.random.default_rng(0).normal(0, 1e-3, (2, 300))])
    points = dense[np.random.default_rng(1).permutation(300)]
    ordered = points[level_order(points, 0.3)]
    sizes = level_sizes(300)
    assert sizes == (300, 75, 18)
    for size in sizes[1:]:
        assert len(np.unique(ordered[:size, 0])) == 10


def test_neighbours_are_the_nearest_points_of_the_level() -> None:
    points = cloud()
    levels = build_hierarchy(points, 6)
    for level, size in enumerate(level_sizes(200)):
        gaps = np.linalg.norm(points[:size, None] - points[None, :size], axis=2)
        np.testing.assert_array_equal(levels.neighbours[level], np.argsort(gaps, axis=1)[:, :6])
    assert [nearest.shape for nearest in levels.above] == [(200, 3), (50, 3)]


def test_the_compiled_maximum_and_its_gradient_are_torchs() -> None:
    rng = np.random.default_rng(0)
    x = torch.from_numpy(rng.normal(size=(2, 30, 5)).astype(np.float32)).requires_grad_()
    neighbours = torch.from_numpy(rng.integers(0, 30, (2, 12, 4)))
    weights = torch.from_numpy(rng.normal(size=(2, 12, 5)).astype(np.float32))
    expected = gather_neighbours(x, neighbours).amax(dim=2)
    (gradient,) = torch.autograd.grad((expected * weights).sum(), x)
    largest = neighbour_max(x, neighbours)
    torch.testing.assert_close(largest, expected, rtol=0, atol=0)
    torch.testing.assert_close(torch.autograd.grad((largest * weights).sum(), x)[0], gradient)
    compiled, plain = (f(x[0].detach().numpy(), neighbours[0].numpy()) for f in (_kernels.neighbour_max, _naive_max))
    for mine, naive in zip(compiled, plain, strict=True):
        np.testing.assert_array_equal(mine, naive)


@pytest.mark.slow
def test_the_entering_layers_in_training_are_the_plain_ones() -> None:
    torch.manual_seed(0)
    fused = OffsetConv(5, 6).double().train()
    torch.nn.init.uniform_(fused.second.norm.weight, -1.5, 1.5)  # of both signs: the largest sum is not always the one
    plain = copy.deepcopy(fused)
    points = torch.from_numpy(np.stack([cloud(), cloud(seed=1)])).requires_grad_()
    neighbours = torch.from_numpy(np.random.default_rng(2).integers(0, 200, (2, 200, 4)))
    edges = plain.first(gather_neighbours(points, neighbours) - points[:, :, None])
    found = []
    for layer, features in (
        (fused, fused(points, neighbours)),
        (plain, plain.second(edges).amax(dim=2)),
    ):
        weights = torch.linspace(-1, 1, features.numel(), dtype=features.dtype).view_as(features)
        found.append(
            [features, *torch.autograd.grad((weights * features.square()).sum(), [points, *layer.parameters()])]
        )
        found[-1] += list(layer.buffers())
    for mine, theirs in zip(*found, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-9, atol=1e-9)
    layers = []
    fused.second.register_forward_hook(lambda *_: layers.append("plain"))
    fused(points, neighbours)
    assert layers == []  # no pass over the normalised edges in training
    fused.eval()(points, neighbours)
    assert layers == ["plain"]


def _naive_max(rows: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    which = rows[neighbours].argmax(axis=1)
    return rows[neighbours].max(axis=1), np.take_along_axis(neighbours, which, axis=1)


def test_a_point_of_the_next_level_is_interpolated_from_itself() -> None:
    points = torch.from_numpy(cloud()[None].astype(np.float32))
    nearest = torch.from_numpy(build_hierarchy(points[0].numpy(), 6).above[0])[None]
    features = torch.rand(1, 50, 4)
    found = interpolate(features, points[:, :50], points, nearest)
    torch.testing.assert_close(found[:, :50], features, rtol=0.01, atol=0.01)
    assert found.shape == (1, 200, 4)


def test_a_shift_of_the_cloud_shifts_the_votes_alone() -> None:
    points, net = cloud(), network()
    shift = np.array([0.5, -0.25, 1.0])
    with torch.no_grad():
        here, there = net(inputs(points)), net(inputs(points + shift))
    moved = torch.from_numpy(np.append(50 * shift, np.zeros(4))).float()
    torch.testing.assert_close(there.embedding_BNF, here.embedding_BNF + moved, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(there.confidence_BN, here.confidence_BN, rtol=1e-3, atol=1e-3)


def test_clouds_of_a_batch_do_not_see_each_other() -> None:
    net = network()
    with torch.no_grad():
        both, second = net(inputs(cloud(), cloud(seed=1))), net(inputs(cloud(seed=1)))
    torch.testing.assert_close(both.embedding_BNF[1], second.embedding_BNF[0], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("count", [1, 3, 17])
def test_few_points_are_enough(count: int) -> None:
    with torch.no_grad():
        found = network()(inputs(cloud(count)))
    assert found.embedding_BNF.shape == (1, count, 7)
    assert torch.isfinite(found.embedding_BNF).all()


def test_a_window_holds_the_nearest_points_in_the_image_plane() -> None:
    points = np.array([[0.0, 0, 0], [3, 0, 0], [1, 0, 9], [2, 0, 0]])
    assert window(points, 0, 3).tolist() == [0, 2, 3]
    assert window(points, 0, 9).tolist() == [0, 2, 3, 1]


def test_nonsense_is_named() -> None:
    for settings, text in (
        ({"k": 0}, "k must be at least 1, got 0"),
        ({"widths": (1, 2)}, "widths must be 3 positive channel counts"),
        ({"depths": (1, -1, 1)}, "depths must be 3 numbers of EdgeConvs"),
        ({"spacing": 0.0}, r"spacing must be in \(0, 1\), got 0.0"),
        ({"vote_scale": -1.0}, "vote_scale must not be negative, got -1.0"),
    ):
        with pytest.raises(ValueError, match=text):
            ContextNetConfig(**settings)
