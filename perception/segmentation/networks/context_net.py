"""The context network: EdgeConvs on a cloud and on 1/4 and 1/16 of its points, with the heads of SGPN.

DGCNN's trunk lacks context: with 25 parts in a cloud of 2048 points, a neighbourhood of 16 points is a fifth of a part.
Here the neighbourhoods of the last level are of the size of a part.

Shapes: B clouds, N points of a level, M points of a level or its first quarter, K neighbours, C channels, J = 3 points.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor, nn

from perception.segmentation.networks import _kernels
from perception.segmentation.networks.dgcnn import SLOPE, gather_neighbours
from perception.segmentation.networks.edge_training import largest_activation
from perception.segmentation.networks.hierarchy import LEVELS, Hierarchy
from perception.segmentation.networks.output import PointOutputs
from perception.segmentation.networks.pointnet import SharedLayer, require_at_least_one

DEEPEST = 50  # largest number of EdgeConvs on a level; more are a damaged file


@dataclass(frozen=True, kw_only=True)
class ContextNetConfig:
    """Sizes of the network."""

    k: int = 16  # number of neighbours, the point itself included
    spacing: float = 0.025  # distance of the points that the network sees, in units of d_max
    edge_k: int = 10  # number of neighbours of the EdgeConv that enters the network
    edge: int = 32  # width of the first layer on the edges of the cloud
    widths: tuple[int, int, int] = (64, 128, 192)  # channels of a point on each level
    depths: tuple[int, int, int] = (1, 2, 3)  # number of EdgeConvs on each level, besides the one that enters it
    branch: int = 64  # width of the hidden layer of each head
    embedding: int = 32  # number of learned dimensions of the embedding, besides the three of the vote
    vote_scale: float = 50.0  # factor of the vote for the centre of the part [d_max] in the embedding
    classes: int = 1  # number of semantic classes

    def __post_init__(self) -> None:
        require_at_least_one(self, "k", "edge_k", "edge", "branch", "embedding", "classes")
        if len(self.widths) != LEVELS or min(self.widths) < 1:
            raise ValueError(f"widths must be {LEVELS} positive channel counts, got {self.widths}")
        if len(self.depths) != LEVELS or not 0 <= min(self.depths) <= max(self.depths) <= DEEPEST:
            raise ValueError(f"depths must be {LEVELS} numbers of EdgeConvs from 0 to {DEEPEST}, got {self.depths}")
        if not 0 < self.spacing < 1:
            raise ValueError(f"spacing must be in (0, 1), got {self.spacing}")
        if not self.vote_scale >= 0:
            raise ValueError(f"vote_scale must not be negative, got {self.vote_scale}")


class ContextInputs(NamedTuple):
    """A batch of :class:`perception.segmentation.networks.hierarchy.Hierarchy`, clouds of equally many points.

    Attributes:
        points_BN3: Points in units of d_max.
        fine_BNK: Neighbours of each point.
        middle_BNK: Neighbours of each point of the second level.
        coarse_BNK: Neighbours of each point of the third level.
        to_fine_BNJ: Points of the second level that each point is interpolated from.
        to_middle_BNJ: Points of the third level that each point of the second level is interpolated from.
    """

    points_BN3: Tensor
    fine_BNK: Tensor
    middle_BNK: Tensor
    coarse_BNK: Tensor
    to_fine_BNJ: Tensor
    to_middle_BNJ: Tensor

    @classmethod
    def of(cls, clouds: list[Hierarchy]) -> "ContextInputs":
        """Return the batch of clouds."""
        rows = [(cloud.points, *cloud.neighbours, *cloud.above) for cloud in clouds]
        return cls(*(torch.stack([torch.from_numpy(a) for a in arrays]) for arrays in zip(*rows, strict=True)))


class OffsetConv(nn.Module):
    """The EdgeConv that enters the network: two layers on the offset ``p_j - p_i`` of each edge, and the maximum."""

    def __init__(self, hidden: int, width: int) -> None:
        super().__init__()
        self.first = SharedLayer(3, hidden, SLOPE)
        self.second = SharedLayer(hidden, width, SLOPE)

    def forward(self, points_BN3: Tensor, neighbours_BNK: Tensor) -> Tensor:
        """Return (B, N, width) features."""
        offsets_BNK3 = gather_neighbours(points_BN3, neighbours_BNK) - points_BN3[:, :, None]
        edges_BNKC = self.first(offsets_BNK3)
        if self.training and points_BN3.device.type == "cpu":
            return largest_activation(self.second.linear(edges_BNKC), self.second.norm, SLOPE)
        edges_BNKC = self.second(edges_BNKC)
        order_NK = torch.arange(neighbours_BNK[0].numel(), device=points_BN3.device).view(neighbours_BNK.shape[1:])
        return neighbour_max(edges_BNKC.flatten(1, 2), order_NK.expand(neighbours_BNK.shape))


class ContextConv(nn.Module):
    """EdgeConv of one layer on ``[x_i, x_j, p_j - p_i]``, then one on the points.

    The maximum over j of ``A x_j + P (p_j - p_i) + B x_i`` needs the first term for each point only, not each edge; and
    the normalisation and the ReLU follow the maximum.
    """

    def __init__(self, channels: int, width: int) -> None:
        super().__init__()
        self.neighbour = nn.Linear(channels, width, bias=False)
        self.own = nn.Linear(channels, width, bias=False)
        self.position = nn.Linear(3, width, bias=False)
        self.norm = nn.BatchNorm1d(width)
        self.point = SharedLayer(width, width, SLOPE)
        self.residual = channels == width

    def forward(self, x_BNC: Tensor, points_BN3: Tensor, neighbours_BMK: Tensor) -> Tensor:
        """Return the (B, M, width) features of the first M points."""
        count = neighbours_BMK.shape[1]
        place_BNC = self.position(points_BN3)
        largest_BMC = neighbour_max(self.neighbour(x_BNC) + place_BNC, neighbours_BMK)
        own_BMC = x_BNC[:, :count]
        sums_BMC = largest_BMC - place_BNC[:, :count] + self.own(own_BMC)
        normal = self.norm(sums_BMC.flatten(0, 1)).view(sums_BMC.shape)
        added_BMC: Tensor = self.point(nn.functional.leaky_relu(normal, SLOPE))
        return own_BMC + added_BMC if self.residual else added_BMC


class ContextNet(nn.Module):
    """EdgeConvs down the levels, interpolation back up, and SGPN's heads besides the offset to the centre.

    A shift of the cloud shifts the vote and changes nothing else, so distances in the embedding do not depend on it.
    """

    def __init__(self, config: ContextNetConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or ContextNetConfig()
        widths = config.widths
        self.enter = OffsetConv(config.edge, widths[0])
        self.down = nn.ModuleList(ContextConv(a, b) for a, b in pairwise(widths))
        self.levels = nn.ModuleList(
            nn.ModuleList(ContextConv(width, width) for _ in range(depth))
            for width, depth in zip(widths, config.depths, strict=True)
        )
        self.up = nn.ModuleList(
            nn.Sequential(SharedLayer(a + b, a, SLOPE), SharedLayer(a, a, SLOPE)) for a, b in pairwise(widths)
        )
        self.offset = _head(widths[0], config.branch, 3)
        self.similarity = _head(widths[0], config.branch, config.embedding)
        self.confidence = _head(widths[0], config.branch, 1)
        self.semantics = _head(widths[0], config.branch, config.classes)

    def forward(self, inputs: ContextInputs) -> PointOutputs:
        """Return the outputs of the heads; the embedding is the scaled vote followed by the learned dimensions."""
        neighbours = (inputs.fine_BNK, inputs.middle_BNK, inputs.coarse_BNK)
        points = [inputs.points_BN3[:, : edges.shape[1]] for edges in neighbours]
        x_BNC = self.enter(points[0], neighbours[0][..., : self.config.edge_k])
        kept = []
        for level, convs in enumerate(self.levels):
            if level:
                entering = neighbours[level - 1][:, : points[level].shape[1]]
                x_BNC = self.down[level - 1](x_BNC, points[level - 1], entering)
            for conv in cast(nn.ModuleList, convs):
                x_BNC = conv(x_BNC, points[level], neighbours[level])
            kept.append(x_BNC)
        for level, nearest in ((1, inputs.to_middle_BNJ), (0, inputs.to_fine_BNJ)):
            coarse_BNC = interpolate(x_BNC, points[level + 1], points[level], nearest)
            x_BNC = self.up[level](torch.cat([kept[level], coarse_BNC], dim=-1))
        offsets_BN3 = self.offset(x_BNC)
        votes_BN3 = inputs.points_BN3 + offsets_BN3
        return PointOutputs(
            embedding_BNF=torch.cat([self.config.vote_scale * votes_BN3, self.similarity(x_BNC)], dim=-1),
            confidence_BN=torch.sigmoid(self.confidence(x_BNC)).squeeze(-1),
            semantics_BNS=self.semantics(x_BNC),
            offsets_BN3=offsets_BN3,
        )


def interpolate(x_BMC: Tensor, from_BM3: Tensor, to_BN3: Tensor, nearest_BNJ: Tensor) -> Tensor:
    """Return the (B, N, C) features at points, interpolated from those of their nearest points by inverse squares.

    Source: the feature propagation of Qi et al., "PointNet++", NeurIPS 2017.
    """
    squares_BNJ = (gather_neighbours(from_BM3, nearest_BNJ) - to_BN3[:, :, None]).square().sum(-1)
    weights_BNJ = 1 / (squares_BNJ + 1e-6)
    weights_BNJ = weights_BNJ / weights_BNJ.sum(-1, keepdim=True)
    return torch.einsum("bnj,bnjc->bnc", weights_BNJ, gather_neighbours(x_BMC, nearest_BNJ))


def neighbour_max(x_BNC: Tensor, neighbours_BMK: Tensor) -> Tensor:
    """Return the (B, M, C) maxima of each channel over the neighbours of each point."""
    return cast(Tensor, _NeighbourMax.apply(x_BNC, neighbours_BMK))  # type: ignore[no-untyped-call]


class _NeighbourMax(torch.autograd.Function):
    """The maximum whose gradient goes to B * M * C places rather than through all the edges."""

    @staticmethod
    def forward(ctx: Any, x_BNC: Tensor, neighbours_BMK: Tensor) -> Tensor:
        if x_BNC.device.type == "cpu":
            pairs = [_compiled_max(x, neighbours) for x, neighbours in zip(x_BNC, neighbours_BMK, strict=True)]
            largest_BMC, source_BMC = (torch.stack(tensors) for tensors in zip(*pairs, strict=True))
        else:
            largest_BMC, which_BMC = gather_neighbours(x_BNC, neighbours_BMK).max(dim=2)
            source_BMC = neighbours_BMK.gather(2, which_BMC)
        ctx.shape = x_BNC.shape
        ctx.save_for_backward(source_BMC)
        return largest_BMC

    @staticmethod
    def backward(ctx: Any, gradient_BMC: Tensor) -> tuple[Tensor, None]:
        (source_BMC,) = ctx.saved_tensors
        return gradient_BMC.new_zeros(ctx.shape).scatter_add_(1, source_BMC, gradient_BMC), None


def _compiled_max(x_NC: Tensor, neighbours_MK: Tensor) -> tuple[Tensor, Tensor]:
    largest, source = _kernels.neighbour_max(x_NC.float().contiguous().numpy(), neighbours_MK.contiguous().numpy())
    return torch.from_numpy(largest).to(x_NC.dtype), torch.from_numpy(source)


def _head(width: int, branch: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(width, branch), nn.ReLU(), nn.Linear(branch, outputs))
