"""The image-plane network: a U-Net over cells, whose features are gathered at the points.

It is not in the paper. The boundary cloud of a single view is an image, so neighbourhoods need no search. A receptive
field of several parts costs as much as an EdgeConv over one. Similarity, confidence and losses are SGPN's.

Shapes: B scenes, N points, C channels, H x W cells, L local features, F dimensions of the embedding.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from perception.segmentation.networks.grid import CHANNELS, LOCAL
from perception.segmentation.networks.output import PointOutputs
from perception.shape import VALUES

Singles = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class GridNetConfig:
    """Sizes of the network."""

    widths: tuple[int, ...] = (32, 64, 128, 160, 192)  # channels at 1, 1/2, 1/4, 1/8 and 1/16 of the resolution
    hidden: int = 64  # width of the layers on the points
    embedding: int = 16  # number of learned dimensions of the embedding, besides the three of the vote
    vote_scale: float = 50.0  # factor of the vote for the centre of the part [d_max] in the embedding
    classes: int = 1  # number of semantic classes
    shape: bool = False  # whether the network can be told the shape of the part; it knows d_max in any case

    def __post_init__(self) -> None:
        if len(self.widths) != 5 or min(self.widths) < 1:
            raise ValueError(f"widths must be five positive channel counts, got {self.widths}")
        for name in ("hidden", "embedding", "classes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not self.vote_scale >= 0:
            raise ValueError(f"vote_scale must not be negative, got {self.vote_scale}")


class GridInputs(NamedTuple):
    """A batch of :class:`perception.segmentation.networks.grid.GridView`.

    Attributes:
        cells_BCHW: Channels of the coarse cells.
        place_BN2: Column and row of each point in coarse cells.
        local_BNL: Local features of each point.
        points_BN3: Points in the camera frame, in units of d_max.
        shape_BS: Shape of the part, as :func:`shape_input` returns it; None where no network needs it.
    """

    cells_BCHW: Tensor
    place_BN2: Tensor
    local_BNL: Tensor
    points_BN3: Tensor
    shape_BS: Tensor | None = None


def shape_input(values: NDArray[np.floating] | None) -> Singles:
    """Return the (6,) input of a network for the (5,) values of a shape followed by 1, or zeros if it is unknown.

    Args:
        values: Values that describe the shape, as :func:`perception.shape.shape_values` returns them, or None.
    """
    if values is None:
        return np.zeros(VALUES + 1, np.float32)
    return np.append(values, 1.0).astype(np.float32)


class GridNet(nn.Module):
    """U-Net over cells, MLP over points, four heads: offset to the centre, embedding, confidence, semantics."""

    def __init__(self, config: GridNetConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or GridNetConfig()
        widths = config.widths
        self.stem = _block(CHANNELS, widths[0])
        self.down = nn.ModuleList(nn.Sequential(_block(a, b, stride=2), _Residual(b)) for a, b in pairwise(widths))
        self.lateral = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairwise(widths))
        self.up = nn.ModuleList(nn.Sequential(_block(2 * a, a), _Residual(a)) for a in widths[:-1])
        self.points = nn.Sequential(
            nn.Linear(widths[0] + LOCAL, config.hidden),
            nn.LayerNorm(config.hidden),
            nn.ReLU(),
            nn.Linear(config.hidden, config.hidden),
            nn.LayerNorm(config.hidden),
            nn.ReLU(),
        )
        self.offset = nn.Linear(config.hidden, 3)
        self.similarity = nn.Linear(config.hidden, config.embedding)
        self.confidence = nn.Linear(config.hidden, 1)
        self.semantics = nn.Linear(config.hidden, config.classes)
        self.shape = nn.ModuleList(_silent(VALUES + 1, a) for a in widths[1:] if config.shape)

    def forward(self, inputs: GridInputs) -> PointOutputs:
        """Return the outputs of the heads; the embedding is the scaled vote followed by the learned dimensions."""
        levels = [self.stem(inputs.cells_BCHW.contiguous(memory_format=torch.channels_last))]
        for down in self.down:
            levels.append(down(levels[-1]))
        features = levels.pop()
        for level in reversed(range(len(self.up))):
            lateral, up = self.lateral[level], self.up[level]
            if self.config.shape:
                features = features + self._shape_features(inputs, level)
            grown = nn.functional.interpolate(lateral(features), scale_factor=2.0, mode="nearest")
            features = up(torch.cat([levels.pop(), grown], dim=1))
        gathered_BNF = gather_bilinear(features.float(), inputs.place_BN2)
        with torch.autocast(features.device.type, enabled=False):
            hidden_BNF = self.points(torch.cat([gathered_BNF, inputs.local_BNL], dim=-1))
            offsets_BN3 = self.offset(hidden_BNF)
            votes_BN3 = inputs.points_BN3 + offsets_BN3
            embedding_BNF = torch.cat([self.config.vote_scale * votes_BN3, self.similarity(hidden_BNF)], dim=-1)
            return PointOutputs(
                embedding_BNF=embedding_BNF,
                confidence_BN=torch.sigmoid(self.confidence(hidden_BNF)).squeeze(-1),
                semantics_BNS=self.semantics(hidden_BNF),
                offsets_BN3=offsets_BN3,
            )

    def _shape_features(self, inputs: GridInputs, level: int) -> Tensor:
        """Return what the shape of the part adds to the (B, C, H, W) features below a level."""
        shape_BS = inputs.shape_BS
        if shape_BS is None:
            shape_BS = inputs.cells_BCHW.new_zeros(len(inputs.cells_BCHW), VALUES + 1)
        added: Tensor = self.shape[level](shape_BS)
        return added[:, :, None, None]


def gather_bilinear(features_BCHW: Tensor, place_BN2: Tensor) -> Tensor:
    """Return the (B, N, C) bilinear features at places (column, row), clamped to the centres of the outermost cells."""
    batch, channels, height, width = features_BCHW.shape
    rows_XC = features_BCHW.permute(0, 2, 3, 1).reshape(-1, channels)
    x = (place_BN2[..., 0] - 0.5).clamp(0, width - 1)
    y = (place_BN2[..., 1] - 0.5).clamp(0, height - 1)
    x0, y0 = x.floor().long().clamp(max=width - 2), y.floor().long().clamp(max=height - 2)
    fx, fy = (x - x0).unsqueeze(-1), (y - y0).unsqueeze(-1)
    first = (torch.arange(batch, device=x.device)[:, None] * height + y0) * width + x0
    flat = [rows_XC.index_select(0, (first + step).reshape(-1)) for step in (0, 1, width, width + 1)]
    corners = [corner.view(batch, -1, channels) for corner in flat]
    top = corners[0] * (1 - fx) + corners[1] * fx
    bottom = corners[2] * (1 - fx) + corners[3] * fx
    return top * (1 - fy) + bottom * fy


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = _block(width, width)
        self.second = nn.Sequential(nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(self.first(x)))


def _silent(inner: int, outer: int) -> nn.Linear:
    """Return a layer that returns 0 until it is trained."""
    layer = nn.Linear(inner, outer)
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def _block(inner: int, outer: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inner, outer, 3, stride=stride, padding=1, bias=False), nn.BatchNorm2d(outer), nn.ReLU()
    )
