"""What the tests of the loss terms share: their twin, random scenes, values with gradients."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import torch

from perception.segmentation.training.losses import (
    PairLossConfig,
    pair_loss,
)

TWIN = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[3] / "reference" / "losses_twin.py")))
ALL = PairLossConfig(anchors=None)
KINDS = ["double_hinge", "focal_double_hinge"]
DISTANCES = ["l2", "scaled_square"]

# Four points on a line: two of one instance, one of another, one of another class.
LINE_IDS = torch.tensor([[0, 0, 1, 2]])
LINE_CLASSES = torch.tensor([[0, 0, 0, 1]])


def on_a_line(*values):
    return torch.tensor([[[value] for value in values]], dtype=torch.float64, requires_grad=True)


def scene(seed, clouds=3, points=14, dims=4, instances=4, dtype=torch.float64):
    """Distances on both sides of every margin, void points, two classes; the last cloud is padded with void."""
    g = torch.Generator().manual_seed(seed)
    ids = torch.randint(-1, instances, (clouds, points), generator=g)
    ids[-1, points // 2 :] = -1
    return SimpleNamespace(
        embedding=(torch.randn(clouds, points, dims, generator=g, dtype=torch.float64) * 4).to(dtype),
        ids=ids,
        classes=torch.randint(0, 2, (clouds, points), generator=g),
        points=torch.rand(clouds, points, 3, generator=g, dtype=torch.float64),
        confidence=torch.rand(clouds, points, generator=g, dtype=torch.float64),
    )


def in_reading(config, embedding):
    """Bring l2 distances about the margins to squares about the margins."""
    return embedding if config.distance == "l2" else embedding / 8


def value_and_gradient(embedding, *args, loss=pair_loss, **kwargs):
    embedding = embedding.detach().requires_grad_()
    value = loss(embedding, *args, **kwargs)
    value.backward()
    return value.detach(), embedding.grad
