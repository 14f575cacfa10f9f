"""A training step by the processes that torchrun starts, against one process with all their samples.

Run by test_distributed.py. What it finds is written to the file that is its argument.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import torch
from torch import Tensor, nn

from perception.segmentation.networks.grid_net import GridInputs, GridNetConfig
from perception.segmentation.training.dataset import Batch, BatchMaker
from perception.segmentation.training.distributed import processes
from perception.segmentation.training.loop import Length, Trainer
from perception.segmentation.training.packed import PackedScene
from perception.segmentation.training.presets import PRESETS
from perception.segmentation.weights import Network, NetworkConfig, build_network
from tests.perception.disc_scene import disc_scene

SAMPLES = 2  # of each process
PROCESSES = 2
OURS = PRESETS["ours"]
CONFIG = replace(
    OURS,
    network=GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=2),
    pairs=replace(OURS.pairs, anchors=None),  # anchors are drawn by each process on its own
    batch=SAMPLES * PROCESSES,
    points=64,
    clip=None,
    bf16=False,
)


@dataclass(frozen=True, eq=False)
class Share:
    """Source of one batch: the samples from ``start`` to ``stop`` of those of all processes.

    Attributes:
        whole: Source of the samples of all processes.
        start: First sample.
        stop: Sample after the last one.
        rank: Index of the process.
    """

    whole: BatchMaker
    start: int
    stop: int
    rank: int = 0

    @property
    def scenes(self) -> list[PackedScene]:
        """Scenes to draw from."""
        return list(self.whole.scenes)

    def __call__(self, step: int) -> Batch:
        """Return the batch of a step."""
        batch, kept = self.whole(step), slice(self.start, self.stop)
        arrays = [None if values is None else values[kept] for values in batch[1:]]
        return Batch(GridInputs(*(None if values is None else values[kept] for values in batch.inputs)), *arrays)


def gradients(share: Share, builder: Callable[[NetworkConfig], Network]) -> dict[str, Tensor]:
    """Return the gradient by each parameter in a training step, on which all processes agree."""
    with patch("perception.segmentation.training.loop.build_network", builder):
        trainer = Trainer(CONFIG, share, Length(steps=1))
    next(trainer.run())
    return {name: values.grad.clone() for name, values in trainer.network.named_parameters() if values.grad is not None}


def difference(some: dict[str, Tensor], others: dict[str, Tensor]) -> float:
    """Return the largest difference of a gradient, relative to the largest gradient."""
    assert some.keys() == others.keys()
    largest = max(float(values.abs().max()) for values in others.values())
    return max(float((some[name] - others[name]).abs().max()) for name in some) / largest


def without_norms(config: NetworkConfig) -> Network:
    """Build a network and take its BatchNorms out."""
    network = build_network(config)
    for module in list(network.modules()):
        for name, child in module.named_children():
            if isinstance(child, nn.BatchNorm2d):
                setattr(module, name, nn.Identity())
    return network


def main(out: Path) -> None:
    """Compute the gradients of both networks, in one process and in several."""
    torch.set_num_threads(1)
    whole = BatchMaker.of(CONFIG, [PackedScene.pack(disc_scene(seed)) for seed in range(2)])
    builders = {"with": build_network, "without": without_norms}
    alone: dict[str, dict[str, Tensor]] = {}
    for name, builder in builders.items():
        alone[name] = gradients(Share(whole, 0, CONFIG.batch), builder)
    with processes() as place:
        assert place.world == PROCESSES
        mine = Share(whole, place.rank * SAMPLES, (place.rank + 1) * SAMPLES, place.rank)
        found = {name: difference(gradients(mine, builder), alone[name]) for name, builder in builders.items()}
        if place.rank == 0:
            out.write_text(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
