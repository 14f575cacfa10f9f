"""Settings of a training, and presets: the paper's text, SGPN's released code, and ours."""

from dataclasses import dataclass, field, replace
from typing import Literal

from perception.segmentation.networks.context_net import ContextNetConfig
from perception.segmentation.networks.grid_net import GridNetConfig
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.training.augment import NONE, AugmentConfig
from perception.segmentation.training.choices import PresetName
from perception.segmentation.training.losses import AlphaSchedule, PairLossConfig
from perception.segmentation.weights import NetworkConfig


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings of a training, besides its scenes and its length."""

    network: NetworkConfig = field(default_factory=GridNetConfig)  # sizes of the network
    pairs: PairLossConfig = field(default_factory=PairLossConfig)  # pair loss
    alpha: AlphaSchedule = field(default_factory=AlphaSchedule)  # weight of pairs of two instances
    augment: AugmentConfig = field(default_factory=AugmentConfig)  # augmentation of the scenes
    offset_weight: float = 0.0  # weight of the loss of the offsets to the centre
    confidence_weight: float = 1.0  # weight of the loss of the confidence
    semantic_weight: float = 1.0  # weight of the loss of the semantic classes
    optimizer: Literal["adam", "adamw"] = "adamw"  # adam has no weight decay
    learning_rate: float = 1e-3  # largest learning rate
    weight_decay: float = 0.01  # weight decay of adamw
    schedule: Literal["constant", "cosine"] = "cosine"  # course of the learning rate after the warm-up
    warmup: int = 200  # number of steps over which the learning rate rises from 0
    final_rate: float = 1e-5  # learning rate at the end of the cosine
    batch: int = 8  # number of scenes in a step of each process
    points: int = 2048  # number of points drawn from a scene
    clip: float | None = 5.0  # largest norm of the gradient; None for no limit
    ema: float | None = 0.999  # decay of the averaged weights that are evaluated and saved; None for the last weights
    bf16: bool = False  # compute the trunk in bfloat16 where the device is fast at it
    seed: int = 0  # seed of the initial weights and of everything that is drawn

    def __post_init__(self) -> None:
        for name in ("offset_weight", "confidence_weight", "semantic_weight", "weight_decay", "warmup", "final_rate"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        for name in ("learning_rate", "batch", "points"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if self.clip is not None and not self.clip > 0:
            raise ValueError(f"clip must be positive, got {self.clip}")
        if self.ema is not None and not 0 <= self.ema < 1:
            raise ValueError(f"ema must be in [0, 1), got {self.ema}")

    @property
    def kind(self) -> Literal["grid", "cloud", "context"]:
        """Kind of samples that the network takes (crops of the grid, clouds of points, or crops of clouds)."""
        if isinstance(self.network, ContextNetConfig):
            return "context"
        return "grid" if isinstance(self.network, GridNetConfig) else "cloud"


# "paper" follows the text of section IV: distances not squared, alpha in steps, batches of 2 x 4096, 200 epochs.
# "dgcnn-sgpn" is the network and the loss of the paper, the latter on anchors, with our augmentation and schedule.
# "released" follows SGPN's released code: 10 d^2, a linear alpha, inverse frequencies, batches of 4.
PRESETS: dict[PresetName, TrainingConfig] = {
    "paper": TrainingConfig(
        network=SgpnConfig(trunk="dgcnn"),
        pairs=PairLossConfig(kind="focal_double_hinge", distance="l2", anchors=None),
        alpha=AlphaSchedule(kind="stepped"),
        augment=NONE,
        optimizer="adam",
        learning_rate=1e-4,
        schedule="constant",
        warmup=0,
        batch=2,
        points=4096,
        clip=None,
        ema=None,
    ),
    "released": TrainingConfig(
        network=SgpnConfig(trunk="pointnet"),
        pairs=PairLossConfig(
            kind="double_hinge", distance="scaled_square", anchors=None, weighting="inverse_frequency"
        ),
        alpha=AlphaSchedule(kind="linear"),
        augment=NONE,
        optimizer="adam",
        learning_rate=1e-4,
        schedule="constant",
        warmup=0,
        batch=4,
        points=4096,
        clip=None,
        ema=None,
    ),
    "ours": TrainingConfig(
        network=GridNetConfig(shape=True),
        pairs=PairLossConfig(kind="focal_double_hinge", distance="l2", anchors=256, reach=1.0),
        alpha=AlphaSchedule(kind="constant"),
        learning_rate=2e-3,
        offset_weight=20.0,
        bf16=True,
    ),
    "dgcnn-context": TrainingConfig(
        network=ContextNetConfig(),
        pairs=PairLossConfig(kind="focal_double_hinge", distance="l2", anchors=192, reach=1.0),
        alpha=AlphaSchedule(kind="constant"),
        learning_rate=2e-3,
        offset_weight=20.0,
        batch=4,
        points=2304,
    ),
    "dgcnn-sgpn": TrainingConfig(
        network=SgpnConfig(trunk="dgcnn"),
        pairs=PairLossConfig(kind="focal_double_hinge", distance="l2", anchors=256, reach=1.0),
        alpha=AlphaSchedule(kind="linear"),
        batch=4,
        points=2048,
    ),
}
EPOCHS = 200  # number of epochs in the paper


def fine_tuning(config: TrainingConfig) -> TrainingConfig:
    """Return the settings with which a trained network is trained further on a single part.

    The learning rate is at most 1e-3 and its warm-up at most 30 steps. On 50 scenes of ``generated:spanner:0``, from
    the network for the catalogue, AP on 10 others was 0.37 after 90 steps; 0.33 with 5e-4, 0.33 with 2e-3 and 200
    steps of warm-up. The averaged weights need no change, since their memory grows with the training.
    """
    return replace(config, learning_rate=min(config.learning_rate, 1e-3), warmup=min(config.warmup, 30))
