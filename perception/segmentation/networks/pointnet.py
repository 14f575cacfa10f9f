"""PointNet's segmentation trunk as SGPN uses it, and the point-wise layers that DGCNN shares with it.

Shapes: B clouds, N points, C channels of a point, F features of a point, G features of a cloud.
"""

from dataclasses import dataclass
from itertools import pairwise

from torch import Tensor, nn
from torch.nn import functional


def require_at_least_one(config: object, *names: str) -> None:
    """Raise a ``ValueError`` unless each named field of ``config`` is at least 1."""
    for name in names:
        if getattr(config, name) < 1:
            raise ValueError(f"{name} must be at least 1, got {getattr(config, name)}")


def require_points(points_BNC: Tensor, channels: int) -> None:
    """Raise a ``ValueError`` unless the batch is (B, N, ``channels``) with at least one cloud and one point."""
    shape = tuple(points_BNC.shape)
    if len(shape) != 3 or shape[-1] != channels or 0 in shape:
        raise ValueError(f"points_BNC must be (B, N, {channels}) with B and N at least 1, got {shape}")


class SharedLayer(nn.Module):
    """Linear layer without bias, batch normalisation and (leaky) ReLU on every row: a "1 x 1 convolution"."""

    def __init__(self, channels: int, width: int, slope: float = 0.0) -> None:
        super().__init__()
        self.linear = nn.Linear(channels, width, bias=False)
        self.norm = nn.BatchNorm2d(width)
        self.slope = slope

    def forward(self, x: Tensor) -> Tensor:
        """Map (..., C) to (..., width)."""
        return self.activate(self.linear(x))

    def activate(self, sums: Tensor) -> Tensor:
        """Normalise (..., width) linear sums over all rows and apply the ReLU."""
        # A CPU normalises a channels-last image about twice as fast as a matrix. The rows are permuted and not indexed,
        # so the gradient has that layout too.
        image = self.norm(sums.reshape(1, -1, 1, sums.shape[-1]).permute(0, 3, 1, 2))
        return functional.leaky_relu(image, self.slope, inplace=True).permute(0, 2, 3, 1).reshape(sums.shape)


class SharedLayerWithCloud(SharedLayer):
    """A shared layer on the features of a point and its cloud, ``[f | g]``, without a copy of g for every point.

    ``W [f ; g] = W_f f + W_g g``, and the second term is computed once per cloud.
    """

    def __init__(self, channels: int, cloud_channels: int, width: int, slope: float = 0.0) -> None:
        super().__init__(channels + cloud_channels, width, slope)
        self.channels = channels

    def forward(self, features_BNC: Tensor, cloud_BG: Tensor | None = None) -> Tensor:
        """Map (B, N, C) and (B, G) to (B, N, width).

        Raises:
            ValueError: ``cloud_BG`` is missing.
        """
        if cloud_BG is None:
            raise ValueError("cloud_BG must be given beside features_BNC")
        of_point, of_cloud = self.linear.weight[:, : self.channels], self.linear.weight[:, self.channels :]
        sums_BNC = functional.linear(features_BNC, of_point) + functional.linear(cloud_BG, of_cloud)[:, None]
        return self.activate(sums_BNC)


@dataclass(frozen=True, kw_only=True)
class PointNetConfig:
    """Sizes of the trunk; the defaults are SGPN's."""

    in_channels: int = 3  # number of coordinates of a point
    widths: tuple[int, ...] = (64, 64, 64, 128, 1024)  # widths of the layers before the maximum over points
    cloud_widths: tuple[int, ...] = (256, 128)  # widths of the fully connected layers on that maximum
    head_widths: tuple[int, ...] = (512, 256)  # widths of the layers on [point | cloud]; the last is the trunk's width

    def __post_init__(self) -> None:
        require_at_least_one(self, "in_channels")
        for name in ("widths", "cloud_widths", "head_widths"):
            if len(getattr(self, name)) == 0 or min(getattr(self, name)) < 1:
                raise ValueError(f"{name} must be one or more positive channel counts, got {getattr(self, name)}")


class PointNetTrunk(nn.Module):
    """PointNet's trunk: features of points and of the cloud by one global maximum, without neighbourhoods.

    Source: Qi et al., "PointNet", CVPR 2017, with the sizes of SGPN's released code and without the input transforms.
    """

    def __init__(self, config: PointNetConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or PointNetConfig()
        self.points = _chain(config.in_channels, config.widths)
        self.cloud = _chain(config.widths[-1], config.cloud_widths)
        self.join = SharedLayerWithCloud(config.widths[-1], config.cloud_widths[-1], config.head_widths[0])
        self.head = _chain(config.head_widths[0], config.head_widths[1:])

    @property
    def width(self) -> int:
        """Number of output features of a point."""
        return self.config.head_widths[-1]

    def forward(self, points_BNC: Tensor) -> Tensor:
        """Return (B, N, F) features.

        Raises:
            ValueError: The shape of the points does not fit, or a single cloud is given in training, where the layers
                on the maximum normalise over clouds.
        """
        require_points(points_BNC, self.config.in_channels)
        if self.training and len(points_BNC) < 2:
            raise ValueError("points_BNC must hold at least 2 clouds in training (batch normalisation), got 1")
        features_BNC: Tensor = self.points(points_BNC)
        # max()[0] rather than amax(): its backward pass is 2.7 times faster on a CPU.
        cloud_BG = self.cloud(features_BNC.max(dim=1)[0])
        features_BNF: Tensor = self.head(self.join(features_BNC, cloud_BG))
        return features_BNF


def _chain(channels: int, widths: tuple[int, ...]) -> nn.Sequential:
    return nn.Sequential(*(SharedLayer(a, b) for a, b in pairwise((channels, *widths))))
