"""SGPN: a trunk and three heads for embedding, confidence and semantic class.

Shapes: B clouds, N points, C coordinates of a point, F dimensions of the embedding, S semantic classes.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from perception.segmentation.networks.dgcnn import DgcnnConfig, DGCNNTrunk
from perception.segmentation.networks.distance import SQUARE_SCALE, Distance
from perception.segmentation.networks.output import PointOutputs
from perception.segmentation.networks.pointnet import PointNetConfig, PointNetTrunk, require_at_least_one

Trunk = Literal["pointnet", "dgcnn"]


@dataclass(frozen=True, kw_only=True)
class SgpnConfig:
    """Sizes of the network: SGPN's with the trunk ``pointnet``, the paper's with ``dgcnn``."""

    trunk: Trunk = "dgcnn"  # trunk that computes the features of the points
    in_channels: int = 3  # number of coordinates of a point: 3, or 9 on S3DIS
    num_classes: int = 1  # number of semantic classes
    embedding: int = 128  # number of dimensions of the embedding (F_SIM)
    branch: int = 128  # width of the hidden layer of the confidence and semantic heads (F_CF, F_SEM)
    k: int = 20  # dgcnn: number of neighbours, the point itself included
    global_width: int = 1024  # number of features of a cloud
    graph_channels: tuple[int, ...] = (0, 1, 2)  # dgcnn: coordinates that define neighbours in the first graph
    reuse_graph: bool = False  # dgcnn: keep the first graph in all layers

    def __post_init__(self) -> None:
        if self.trunk not in get_args(Trunk):
            raise ValueError(f"trunk must be one of {get_args(Trunk)}, got {self.trunk!r}")
        require_at_least_one(self, "num_classes", "embedding", "branch")
        self.trunk_config()

    def trunk_config(self) -> PointNetConfig | DgcnnConfig:
        """Return the sizes of the trunk."""
        if self.trunk == "pointnet":
            return PointNetConfig(in_channels=self.in_channels, widths=(64, 64, 64, 128, self.global_width))
        return DgcnnConfig(
            in_channels=self.in_channels,
            k=self.k,
            global_width=self.global_width,
            graph_channels=self.graph_channels,
            reuse_graph=self.reuse_graph,
        )


class Sgpn(nn.Module):
    """Similarity group proposal network.

    Source: Wang et al., "SGPN", CVPR 2018. As in its released code, each head is a layer with ReLU and without batch
    normalisation on the features of the trunk. The trunk is chosen as in section III.A of the paper.
    """

    def __init__(self, config: SgpnConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or SgpnConfig()
        sizes = config.trunk_config()
        self.trunk = PointNetTrunk(sizes) if isinstance(sizes, PointNetConfig) else DGCNNTrunk(sizes)
        width = self.trunk.width
        self.similarity = nn.Sequential(nn.Linear(width, config.embedding), nn.ReLU())
        self.confidence = nn.Sequential(nn.Linear(width, config.branch), nn.ReLU(), nn.Linear(config.branch, 1))
        self.semantics = nn.Sequential(
            nn.Linear(width, config.branch), nn.ReLU(), nn.Linear(config.branch, config.num_classes)
        )

    def forward(self, points_BNC: Tensor) -> PointOutputs:
        """Return the outputs of the heads, in the dtype of the points also under autocast.

        Raises:
            ValueError: The shape of the points does not fit the config, or PointNet is trained with a single cloud.
        """
        features_BNF = self.trunk(points_BNC)
        dtype = points_BNC.dtype
        return PointOutputs(
            embedding_BNF=self.similarity(features_BNF).to(dtype),
            confidence_BN=torch.sigmoid(self.confidence(features_BNF).to(dtype)).squeeze(-1),
            semantics_BNS=self.semantics(features_BNF).to(dtype),
        )


def similarity_matrix(embedding_BNF: Tensor, distance: Distance = "l2") -> Tensor:
    """Return the similarity matrix S: (..., N, N) pairwise distances in a (..., N, F) embedding, 0 for equal points.

    Args:
        embedding_BNF: Embedding of the points.
        distance: ``l2`` is ``|df|`` (eq. (1) of the paper), ``scaled_square`` ``10 |df|^2`` (SGPN's released code).

    Raises:
        ValueError: There is no such distance.

    Note:
        Memory is O(N^2). Differences are taken before squaring, so the diagonal is exactly 0. Coinciding pairs have
        gradient 0, not NaN.
    """
    if distance not in get_args(Distance):
        raise ValueError(f"distance must be one of {get_args(Distance)}, got {distance!r}")
    lengths = torch.cdist(embedding_BNF, embedding_BNF, compute_mode="donot_use_mm_for_euclid_dist")
    return lengths if distance == "l2" else SQUARE_SCALE * lengths.square()
