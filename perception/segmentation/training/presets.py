"""How networks are trained: the paper's text, the lineage's released code, and ours."""

from dataclasses import dataclass, field
from typing import Literal

from perception.segmentation.networks.grid_net import GridNetConfig
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.training.augment import NONE, AugmentConfig
from perception.segmentation.training.choices import PresetName
from perception.segmentation.training.losses import AlphaSchedule, PairLossConfig


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Everything a training depends on besides its scenes and its length."""

    network: GridNetConfig | SgpnConfig = field(default_factory=GridNetConfig)
    pairs: PairLossConfig = field(default_factory=PairLossConfig)
    alpha: AlphaSchedule = field(default_factory=AlphaSchedule)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    offset_weight: float = 0.0  # of the loss on offsets to the centre
    confidence_weight: float = 1.0
    semantic_weight: float = 1.0
    optimizer: Literal["adam", "adamw"] = "adamw"
    learning_rate: float = 1e-3
    weight_decay: float = 0.01  # of adamw
    schedule: Literal["constant", "cosine"] = "cosine"
    warmup: int = 200  # steps over which the learning rate rises from 0
    final_rate: float = 1e-5  # at the end of the cosine
    batch: int = 8  # scenes a step, of each process
    points: int = 2048  # of a scene
    clip: float | None = 5.0  # largest norm of the gradient
    ema: float | None = 0.999  # decay of the averaged weights that are evaluated and shipped; None: the last ones
    bf16: bool = False  # run the trunk in bfloat16 where the processor knows it
    seed: int = 0

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
    def kind(self) -> Literal["grid", "cloud"]:
        """What the network is fed."""
        return "grid" if isinstance(self.network, GridNetConfig) else "cloud"


# "paper" is section IV's text to the letter: unsquared distances, alpha in steps, batches of 2 x 4096, 200 epochs.
# "released" is what the code of the paper's lineage does: 10 d^2, a linear alpha, inverse frequencies, batch 4.
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
        pairs=PairLossConfig(kind="focal_double_hinge", distance="l2", anchors=256, reach=1.0),
        alpha=AlphaSchedule(kind="constant"),
        learning_rate=2e-3,
        offset_weight=20.0,
        bf16=True,
    ),
}
EPOCHS = 200  # of the paper
