"""EdgeConvs in training with few passes over the edges: outputs, gradients and statistics are the plain layers'."""

import copy

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from perception.segmentation.networks import _edge_kernels
from perception.segmentation.networks.dgcnn import EdgeConv, gather_neighbours


def conv(widths: tuple[int, ...], dtype: torch.dtype = torch.float64) -> EdgeConv:
    torch.manual_seed(0)
    made = EdgeConv(3, widths).to(dtype).train()
    for module in made.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.uniform_(module.weight, -1.5, 1.5)  # scales of both signs: the largest sum is not always the one
            nn.init.normal_(module.bias, 0.0, 0.3)
    return made


def plain(layer: EdgeConv, x: Tensor, neighbours: Tensor) -> Tensor:
    there, here = layer._parts(x)
    return layer.rest(layer.first.activate(gather_neighbours(there, neighbours) + here[:, :, None])).max(dim=2)[0]


def cloud(dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor]:
    rng = np.random.default_rng(0)
    return torch.from_numpy(rng.normal(size=(2, 25, 3))).to(dtype), torch.from_numpy(rng.integers(0, 25, (2, 25, 6)))


@pytest.mark.slow
@pytest.mark.parametrize("widths", [(5,), (5, 4), (5, 6, 4)], ids=["one layer", "two", "three"])
@pytest.mark.parametrize("threads", [1, 2])
def test_outputs_gradients_and_statistics_are_those_of_the_plain_layers(widths: tuple[int, ...], threads: int) -> None:
    fused, reference = conv(widths), conv(widths)
    x, neighbours = cloud()
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        found = []
        for layer, run in ((fused, EdgeConv.forward), (reference, plain)):
            points = x.clone().requires_grad_()
            features = run(layer, points, neighbours)
            weights = torch.linspace(-1, 1, features.numel(), dtype=x.dtype).view_as(features)
            found.append(
                [features, *torch.autograd.grad((weights * features.square()).sum(), [points, *layer.parameters()])]
            )
    finally:
        torch.set_num_threads(before)
    for mine, theirs in zip(*found, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-9, atol=1e-9)
    for mine, theirs in zip(fused.buffers(), reference.buffers(), strict=True):
        torch.testing.assert_close(mine, theirs)


def test_single_precision_and_bfloat16_agree_with_the_plain_layers() -> None:
    fused, (x, neighbours) = conv((16, 16), torch.float32), cloud(torch.float32)
    reference = copy.deepcopy(fused)
    torch.testing.assert_close(fused(x, neighbours), plain(reference, x, neighbours), rtol=1e-4, atol=1e-5)
    with torch.autocast("cpu", torch.bfloat16):
        half = fused(x, neighbours)
    torch.testing.assert_close(half.float(), plain(reference, x, neighbours), rtol=0.1, atol=0.1)


def test_the_compiled_extremes_are_those_of_plain_loops() -> None:
    rng = np.random.default_rng(1)
    there, here, neighbours = rng.normal(size=(9, 3)), rng.normal(size=(9, 3)), rng.integers(0, 9, (9, 4))
    signs = np.array([1.0, -1.0, 1.0])
    sums = there[neighbours] + here[:, None]
    largest, which = np.empty((9, 3)), np.empty((9, 3), np.int64)
    edges = np.arange(36).reshape(9, 4)  # of sums that are stored, each edge has a row of its own
    for cloud in ((there, here, neighbours), (sums.reshape(36, 3), np.zeros((9, 3)), edges)):
        total = _edge_kernels.sum_extremes(*cloud, signs, largest, which)
        np.testing.assert_allclose(largest * signs, (sums * signs).max(axis=1))
        np.testing.assert_allclose(total, [sums.sum(axis=(0, 1)), (sums**2).sum(axis=(0, 1))])
        np.testing.assert_allclose(cloud[0][which, np.arange(3)] + cloud[1], largest)


def test_the_compiled_selection_finds_the_most_similar_the_first_of_equal_ones() -> None:
    scores = np.random.default_rng(2).integers(0, 6, (7, 20)).astype(np.float32)
    found = np.full((9, 5), -1, np.int64)
    _edge_kernels.most_similar(scores, 1, found)
    naive = np.argsort(-scores, axis=1, kind="stable")[:, :5]
    np.testing.assert_array_equal(np.sort(found[1:8], axis=1), np.sort(naive, axis=1))
    assert (found[[0, 8]] == -1).all()
