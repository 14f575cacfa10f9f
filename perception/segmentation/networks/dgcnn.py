"""DGCNN's segmentation trunk: EdgeConvs on nearest-neighbour graphs, built in the features of each layer.

Shapes: B clouds, N points, K neighbours, C channels of a point, F features of a point, G features of a cloud.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional

from perception.segmentation.networks import _edge_kernels
from perception.segmentation.networks.edge_training import (
    activated_sums,
    largest_activation,
    largest_sum_activation,
)
from perception.segmentation.networks.pointnet import (
    SharedLayer,
    SharedLayerWithCloud,
    require_at_least_one,
    require_points,
)

SLOPE = 0.2  # slope of the leaky ReLU, as in the released code
TREE_CHANNELS = 3  # dimensions up to which a kd-tree is faster than dense distances; at 9 it is slower
CHUNK_CPU, CHUNK_GPU = 2**20, 2**26  # number of pairwise scores in memory at once; 4 MB fit a CPU's cache


@dataclass(frozen=True, kw_only=True)
class DgcnnConfig:
    """Sizes of the trunk and its graph; the defaults are those of the released code."""

    in_channels: int = 3  # number of coordinates of a point
    k: int = 20  # number of neighbours, the point itself included
    edge_widths: tuple[tuple[int, ...], ...] = ((64, 64), (64, 64), (64,))  # widths of the layers of each EdgeConv
    global_width: int = 1024  # number of features of a cloud
    head_widths: tuple[int, int] = (512, 256)  # widths of the layers on [point | cloud]; the last is the trunk's width
    graph_channels: tuple[int, ...] = (0, 1, 2)  # coordinates that define neighbours in the first graph
    reuse_graph: bool = False  # keep the first graph in all layers instead of finding neighbours among features

    def __post_init__(self) -> None:
        require_at_least_one(self, "in_channels", "k", "global_width")
        if len(self.edge_widths) == 0 or any(len(widths) == 0 or min(widths) < 1 for widths in self.edge_widths):
            raise ValueError(f"edge_widths must be tuples of positive channel counts, got {self.edge_widths}")
        if len(self.head_widths) != 2 or min(self.head_widths) < 1:
            raise ValueError(f"head_widths must be two positive channel counts, got {self.head_widths}")
        channels = self.graph_channels
        if len(channels) == 0 or min(channels) < 0 or max(channels) >= self.in_channels:
            raise ValueError(
                f"graph_channels must name coordinates from 0 to {self.in_channels - 1} (in_channels), got {channels}"
            )


class EdgeConv(nn.Module):
    """EdgeConv: a small network on every edge ``[x_i, x_j - x_i]``, and the maximum over the edges of a point.

    Source: Wang et al., "Dynamic Graph CNN for Learning on Point Clouds", TOG 2019. The product of the first layer
    factorises: with ``W = [B | A]``, ``W [x_i ; x_j - x_i] = A x_j + (B - A) x_i``, so N rows replace N * K.
    """

    def __init__(self, channels: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.first = SharedLayer(2 * channels, widths[0], SLOPE)
        self.rest = nn.Sequential(*(SharedLayer(a, b, SLOPE) for a, b in pairwise(widths)))

    def forward(self, x_BNC: Tensor, neighbours_BNK: Tensor) -> Tensor:
        """Return the (B, N, widths[-1]) features; ``neighbours_BNK`` are int64 indices of points of the same cloud."""
        if self.training and x_BNC.device.type == "cpu":
            return self._trained(x_BNC, neighbours_BNK)
        there_BNC, here_BNC = self._parts(x_BNC)
        sums_BNKC = gather_neighbours(there_BNC, neighbours_BNK) + here_BNC[:, :, None]
        edges_BNKC = self.first.activate(sums_BNKC)
        # max()[0] rather than amax(): its backward pass is 2.7 times faster on a CPU.
        features_BNC: Tensor = self.rest(edges_BNKC).max(dim=2)[0]
        return features_BNC

    def _trained(self, x_BNC: Tensor, neighbours_BNK: Tensor) -> Tensor:
        """Return the same with batch statistics and few passes over the edges."""
        parts, first = (*self._parts(x_BNC), neighbours_BNK), self.first
        if len(self.rest) == 0:
            return largest_sum_activation(*parts, first.norm, SLOPE)
        edges_BNKC = activated_sums(*parts, first.norm, SLOPE)
        *inner, last = cast(list[SharedLayer], list(self.rest))
        for layer in inner:
            edges_BNKC = layer(edges_BNKC)
        return largest_activation(last.linear(edges_BNKC), last.norm, SLOPE)

    def _parts(self, x_BNC: Tensor) -> tuple[Tensor, Tensor]:
        """Return what each point adds to the sums of edges to it, and of its own edges."""
        # In full precision even under autocast: bfloat16 cannot resolve the difference of near points.
        with torch.autocast(x_BNC.device.type, enabled=False):
            weight = self.first.linear.weight
            of_own, of_offset = weight.chunk(2, dim=1)
            x_BNC = x_BNC.to(weight.dtype)
            return functional.linear(x_BNC, of_offset), functional.linear(x_BNC, of_own - of_offset)


class DGCNNTrunk(nn.Module):
    """DGCNN's trunk: three EdgeConvs, then a global maximum that is joined to the features of each point.

    Source: the released sem_seg model of Wang et al., TOG 2019, without its dropout. For 9-d points of S3DIS that code
    builds the first graph on the normalised coordinates of the room (``graph_channels=(6, 7, 8)``). The default here
    is the metric xyz, whose neighbourhoods do not depend on the proportions of the room.
    """

    def __init__(self, config: DgcnnConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or DgcnnConfig()
        inner = (config.in_channels, *(widths[-1] for widths in config.edge_widths[:-1]))
        self.edges = nn.ModuleList(EdgeConv(a, widths) for a, widths in zip(inner, config.edge_widths, strict=True))
        local = sum(widths[-1] for widths in config.edge_widths)
        self.cloud = SharedLayer(local, config.global_width, SLOPE)
        self.join = SharedLayerWithCloud(local, config.global_width, config.head_widths[0], SLOPE)
        self.head = SharedLayer(*config.head_widths, SLOPE)

    @property
    def width(self) -> int:
        """Number of output features of a point."""
        return self.config.head_widths[-1]

    def forward(self, points_BNC: Tensor) -> Tensor:
        """Return the (B, N, F) features. In a cloud of fewer than k points, all points are neighbours.

        Raises:
            ValueError: The shape of the points does not fit.
        """
        require_points(points_BNC, self.config.in_channels)
        features, x_BNC, neighbours_BNK = [], points_BNC, self._first_graph(points_BNC)
        for layer, edge_conv in enumerate(self.edges):
            if layer > 0 and not self.config.reuse_graph:
                neighbours_BNK = dense_neighbours(x_BNC, self.config.k)
            x_BNC = edge_conv(x_BNC, neighbours_BNK)
            features.append(x_BNC)
        local_BNC = torch.cat(features, dim=-1)
        cloud_BG = self._cloud_features(local_BNC)
        features_BNF: Tensor = self.head(self.join(local_BNC, cloud_BG))
        return features_BNF

    def _cloud_features(self, local_BNC: Tensor) -> Tensor:
        if self.training and local_BNC.device.type == "cpu":
            return largest_activation(self.cloud.linear(local_BNC)[:, None], self.cloud.norm, SLOPE)[:, 0]
        features_BG: Tensor = self.cloud(local_BNC).max(dim=1)[0]
        return features_BG

    def _first_graph(self, points_BNC: Tensor) -> Tensor:
        channels = self.config.graph_channels
        on_cpu = points_BNC.device.type == "cpu"
        find: Callable[[Tensor, int], Tensor]
        find = tree_neighbours if on_cpu and len(channels) <= TREE_CHANNELS else dense_neighbours
        return find(points_BNC[..., list(channels)], self.config.k)


def gather_neighbours(x_BNC: Tensor, neighbours_BNK: Tensor) -> Tensor:
    """Return the (B, M, K, C) rows of each cloud at (B, M, K) indices."""
    batch, count, channels = x_BNC.shape
    first_B11 = torch.arange(batch, device=x_BNC.device)[:, None, None] * count
    rows = x_BNC.reshape(-1, channels).index_select(0, (neighbours_BNK + first_B11).reshape(-1))
    return rows.view(*neighbours_BNK.shape, channels)


def tree_neighbours(x_BNC: Tensor, k: int) -> Tensor:
    """Return the (B, N, min(k, N)) int64 nearest points of the same cloud, the point included, by a kd-tree.

    Note:
        It runs on the CPU, about 3 ms for 1024 points in space, and has no gradient. The order of equal distances is
        arbitrary.
    """
    ranks = np.arange(1, min(k, x_BNC.shape[1]) + 1)
    clouds = x_BNC.detach().cpu().numpy()
    found = np.stack([cKDTree(cloud).query(cloud, ranks)[1] for cloud in clouds])
    return torch.from_numpy(found.astype(np.int64, copy=False)).to(x_BNC.device)


@torch.no_grad()
def dense_neighbours(x_BNC: Tensor, k: int) -> Tensor:
    """Return the (B, N, min(k, N)) int64 nearest points of the same cloud, unsorted, by products of all pairs.

    Note:
        Time is O(N^2); chunks of rows bound the memory. There is no gradient. The choice among equal distances is
        arbitrary.
    """
    k = min(k, x_BNC.shape[1])
    chunk = max(1, (CHUNK_CPU if x_BNC.device.type == "cpu" else CHUNK_GPU) // x_BNC.shape[1])
    with torch.autocast(x_BNC.device.type, enabled=False):
        x_BNC = x_BNC if x_BNC.dtype == torch.float64 else x_BNC.float()
        x_BNC = x_BNC - x_BNC.mean(dim=1, keepdim=True)  # centred, because products of large coordinates cancel
        return torch.stack([_dense_neighbours_of_cloud(x_NC, k, chunk) for x_NC in x_BNC])


def _dense_neighbours_of_cloud(x_NC: Tensor, k: int, chunk: int) -> Tensor:
    # |x_i - x_j|^2 = |x_i|^2 - 2 (x_i x_j - |x_j|^2 / 2): the nearest of i are the largest brackets.
    bias_1N = -0.5 * x_NC.square().sum(dim=1)[None]
    x_CN = x_NC.t()
    chunks = (torch.addmm(bias_1N, rows, x_CN) for rows in torch.split(x_NC, chunk))
    if x_NC.device.type != "cpu":
        return torch.cat([scores.topk(k, dim=1, sorted=False)[1] for scores in chunks])
    found, first = np.empty((len(x_NC), k), np.int64), 0
    for scores in chunks:
        _edge_kernels.most_similar(scores.numpy(), first, found)
        first += len(scores)
    return torch.from_numpy(found)
