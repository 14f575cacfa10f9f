"""DGCNN's segmentation trunk: EdgeConvs on graphs of nearest neighbours, which are found anew in each layer's features.

Shapes: B clouds, N points, K neighbours, C channels of a point, F features of a point, G features of a cloud.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional

from perception.segmentation.networks.pointnet import (
    SharedLayer,
    SharedLayerWithCloud,
    require_at_least_one,
    require_points,
)

SLOPE = 0.2  # of the leaky ReLU, as released
TREE_CHANNELS = 3  # up to here a kd-tree beats dense distances; in 9-d it is already slower
CHUNK_CPU, CHUNK_GPU = 2**20, 2**26  # scores that are alive at once; 4 MB stay in a CPU's cache


@dataclass(frozen=True, kw_only=True)
class DgcnnConfig:
    """Sizes of the trunk and its graph; the defaults are the released ones."""

    in_channels: int = 3  # coordinates of a point
    k: int = 20  # neighbours, the point itself included
    edge_widths: tuple[tuple[int, ...], ...] = ((64, 64), (64, 64), (64,))  # of each EdgeConv's layers
    global_width: int = 1024  # features of the cloud
    head_widths: tuple[int, int] = (512, 256)  # of the layers on [point | cloud]; the last is the trunk's width
    graph_channels: tuple[int, ...] = (0, 1, 2)  # coordinates in which the first graph's neighbours are near
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
    """A small network on every edge ``[x_i, x_j - x_i]``, and the maximum over each point's edges.

    Source: Wang et al., "Dynamic Graph CNN for Learning on Point Clouds", TOG 2019. The first layer's product
    factorises: with ``W = [B | A]``, ``W [x_i ; x_j - x_i] = A x_j + (B - A) x_i``, N rows each instead of N * K.
    """

    def __init__(self, channels: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.first = SharedLayer(2 * channels, widths[0], SLOPE)
        self.rest = nn.Sequential(*(SharedLayer(a, b, SLOPE) for a, b in pairwise(widths)))

    def forward(self, x_BNC: Tensor, neighbours_BNK: Tensor) -> Tensor:
        """Return (B, N, widths[-1]) features; ``neighbours_BNK`` int64 holds indices of points of the same cloud."""
        edges_BNKC = self.first.activate(self._first_sums(x_BNC, neighbours_BNK))
        # A maximum's [0] rather than amax: its backward is 2.7 times faster on a CPU.
        features_BNC: Tensor = self.rest(edges_BNKC).max(dim=2)[0]
        return features_BNC

    def _first_sums(self, x_BNC: Tensor, neighbours_BNK: Tensor) -> Tensor:
        # In full precision even under autocast: the difference of near points would drown in bfloat16.
        with torch.autocast(x_BNC.device.type, enabled=False):
            weight = self.first.linear.weight
            of_own, of_offset = weight.chunk(2, dim=1)
            x_BNC = x_BNC.to(weight.dtype)
            there_BNC = functional.linear(x_BNC, of_offset)
            here_BNC = functional.linear(x_BNC, of_own - of_offset)
            return gather_neighbours(there_BNC, neighbours_BNK) + here_BNC[:, :, None]


class DGCNNTrunk(nn.Module):
    """Points to features that know their surroundings: three EdgeConvs, then a global maximum joined to each point.

    Source: the released sem_seg model of Wang et al., TOG 2019, without its dropout. For 9-d S3DIS points that code
    builds the first graph on the room's normalised coordinates (``graph_channels=(6, 7, 8)``); here the default is the
    metric xyz that come first, whose neighbourhoods do not depend on the room's proportions.
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
        """Features of a point that come out."""
        return self.config.head_widths[-1]

    def forward(self, points_BNC: Tensor) -> Tensor:
        """Return (B, N, F) features; a cloud of fewer than k points has all of them as neighbours.

        Raises:
            ValueError: The points' shape does not fit.
        """
        require_points(points_BNC, self.config.in_channels)
        features, x_BNC, neighbours_BNK = [], points_BNC, self._first_graph(points_BNC)
        for layer, edge_conv in enumerate(self.edges):
            if layer > 0 and not self.config.reuse_graph:
                neighbours_BNK = dense_neighbours(x_BNC, self.config.k)
            x_BNC = edge_conv(x_BNC, neighbours_BNK)
            features.append(x_BNC)
        local_BNC = torch.cat(features, dim=-1)
        cloud_BG = self.cloud(local_BNC).max(dim=1)[0]
        features_BNF: Tensor = self.head(self.join(local_BNC, cloud_BG))
        return features_BNF

    def _first_graph(self, points_BNC: Tensor) -> Tensor:
        channels = self.config.graph_channels
        on_cpu = points_BNC.device.type == "cpu"
        find: Callable[[Tensor, int], Tensor]
        find = tree_neighbours if on_cpu and len(channels) <= TREE_CHANNELS else dense_neighbours
        return find(points_BNC[..., list(channels)], self.config.k)


def gather_neighbours(x_BNC: Tensor, neighbours_BNK: Tensor) -> Tensor:
    """Return (B, N, K, C): the rows of each cloud that (B, M, K) indices name."""
    batch, count, channels = x_BNC.shape
    first_B11 = torch.arange(batch, device=x_BNC.device)[:, None, None] * count
    rows = x_BNC.reshape(-1, channels).index_select(0, (neighbours_BNK + first_B11).reshape(-1))
    return rows.view(*neighbours_BNK.shape, channels)


def tree_neighbours(x_BNC: Tensor, k: int) -> Tensor:
    """Return (B, N, min(k, N)) int64 nearest points in the same cloud, the point among them, by a kd-tree.

    Note: runs on the CPU, about 3 ms for 1024 points in space. No gradient. Equal distances fall as they please.
    """
    ranks = np.arange(1, min(k, x_BNC.shape[1]) + 1)
    clouds = x_BNC.detach().cpu().numpy()
    found = np.stack([cKDTree(cloud).query(cloud, ranks)[1] for cloud in clouds])
    return torch.from_numpy(found.astype(np.int64, copy=False)).to(x_BNC.device)


@torch.no_grad()
def dense_neighbours(x_BNC: Tensor, k: int) -> Tensor:
    """Return (B, N, min(k, N)) int64 nearest points in the same cloud, in no order, by products of all pairs.

    Note: O(N^2) time, in chunks of rows that bound the memory. No gradient. Equal distances fall as they please.
    """
    k = min(k, x_BNC.shape[1])
    chunk = max(1, (CHUNK_CPU if x_BNC.device.type == "cpu" else CHUNK_GPU) // x_BNC.shape[1])
    with torch.autocast(x_BNC.device.type, enabled=False):
        x_BNC = x_BNC if x_BNC.dtype == torch.float64 else x_BNC.float()
        x_BNC = x_BNC - x_BNC.mean(dim=1, keepdim=True)  # products of large coordinates would cancel
        return torch.stack([_dense_neighbours_of_cloud(x_NC, k, chunk) for x_NC in x_BNC])


def _dense_neighbours_of_cloud(x_NC: Tensor, k: int, chunk: int) -> Tensor:
    # |x_i - x_j|^2 = |x_i|^2 - 2 (x_i x_j - |x_j|^2 / 2): the nearest of i are the largest brackets.
    bias_1N = -0.5 * x_NC.square().sum(dim=1)[None]
    x_CN = x_NC.t()
    chunks = [torch.addmm(bias_1N, rows, x_CN).topk(k, dim=1, sorted=False)[1] for rows in torch.split(x_NC, chunk)]
    return torch.cat(chunks)
