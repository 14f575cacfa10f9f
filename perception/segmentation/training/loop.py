"""The training loop. A step is a pure function of state, scenes, seed and step, so a resumed training is identical."""

import math
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.networks.output import PointOutputs
from perception.segmentation.networks.precision import half_precision
from perception.segmentation.training.dataset import Batch, BatchSource
from perception.segmentation.training.errors import TrainingError
from perception.segmentation.training.losses import (
    PointAttributes,
    confidence_loss,
    offset_loss,
    pair_loss,
    semantic_loss,
)
from perception.segmentation.training.presets import TrainingConfig
from perception.segmentation.weights import Network, build_network

SKIPS = 10  # number of successive updates that may be skipped because a loss or gradient is not finite


@dataclass(frozen=True, kw_only=True)
class Length:
    """Length of a training; exactly one of the two is given.

    Attributes:
        steps: Number of steps.
        minutes: Time of training [min].
    """

    steps: int | None = None
    minutes: float | None = None

    def __post_init__(self) -> None:
        given = [value for value in (self.steps, self.minutes) if value is not None]
        if len(given) != 1 or not given[0] > 0:
            raise ValueError(f"give either steps or minutes, positive; got steps {self.steps}, minutes {self.minutes}")

    def progress(self, step: int, elapsed: float) -> float:
        """Return the share in [0, 1] that is done after ``step`` steps and ``elapsed`` seconds."""
        done = step / self.steps if self.steps is not None else elapsed / (60.0 * (self.minutes or 1.0))
        return min(done, 1.0)


@dataclass(frozen=True, kw_only=True)
class StepRecord:
    """Result of a training step.

    Attributes:
        step: Number of steps done.
        progress: Share of the training that was done before the step, in [0, 1].
        losses: Unweighted terms of the loss, and the weighted ``total``.
        learning_rate: Learning rate of the step.
        norm: Norm of the gradient before clipping.
        skipped: Whether the update was skipped because the gradient was not finite.
    """

    step: int
    progress: float
    losses: dict[str, float]
    learning_rate: float
    norm: float
    skipped: bool


class Trainer:
    """State and loop of a training. Of processes that train together, each holds a trainer."""

    def __init__(
        self, config: TrainingConfig, batches: BatchSource, length: Length, device: torch.device | str = "cpu"
    ) -> None:
        """Build the network and the optimizer.

        Args:
            config: Settings of the training.
            batches: Source of the batches.
            length: Length of the training.
            device: Device of the computation.
        """
        torch.manual_seed(config.seed)
        self.config, self.batches, self.length, self.device = config, batches, length, torch.device(device)
        self.network = build_network(config.network).to(self.device)
        if isinstance(self.network, GridNet):
            self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.averaged = build_network(config.network).to(self.device).requires_grad_(False)
        self.averaged.load_state_dict(self.network.state_dict())
        self.averaged.eval()
        self.optimizer = _optimizer(config, self.network)
        self.step = 0
        self.elapsed = 0.0
        self.initial: dict[str, Any] | None = (
            None  # record of the network that it started from; None for random weights
        )
        self.unlogged: list[dict[str, float]] = []  # losses of the steps since the last line of the log
        self.whole = True  # whether no step is under way, so that the state can be saved
        self._skips = 0
        self._parallel: nn.Module = self.network
        self.world = 1
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            self.world = torch.distributed.get_world_size()
            self._parallel = nn.parallel.DistributedDataParallel(self.network)

    def start_from(self, network: Network) -> None:
        """Start from the weights of another training of the same network, which may not have been told the shape.

        Raises:
            TrainingError: The configurations of the networks differ.
        """
        theirs = network.config
        if isinstance(theirs, GridNetConfig) and isinstance(self.network, GridNet):
            theirs = replace(theirs, shape=theirs.shape or self.network.config.shape)
        if theirs != self.network.config:
            raise TrainingError(
                f"the initial weights are of {network.config}, this training is of {self.network.config}"
            )
        # A network that is not told the shape is one on which the shape has no effect.
        state = {**self.network.state_dict(), **network.state_dict()}
        self.network.load_state_dict(state)
        self.averaged.load_state_dict(state)

    def run(self) -> Iterator[StepRecord]:
        """Train to the end and yield after each step; the next batch is made in the background.

        Raises:
            TrainingError: Losses stay infinite, or processes that train together are at different steps.
        """
        self._require_one_step()
        with ThreadPoolExecutor(1) as ahead:
            coming = ahead.submit(self.batches, self.step)
            while self.progress < 1.0:
                started = time.perf_counter()
                batch = coming.result()
                coming = ahead.submit(self.batches, self.step + 1)
                record = self._train(batch)
                self.elapsed += time.perf_counter() - started
                yield record

    @property
    def progress(self) -> float:
        """Share of the training that is done; it is the same in every process."""
        share = self.length.progress(self.step, self.elapsed)
        if self._parallel is not self.network and self.length.minutes is not None:
            agreed = torch.tensor(share, device=self.device)
            torch.distributed.broadcast(agreed, 0)
            return float(agreed)
        return share

    @property
    def epoch(self) -> float:
        """Average number of times that a scene has been drawn."""
        return self.step * self.config.batch * self.world / len(self.batches.scenes)

    def best_network(self) -> Network:
        """Return the network to evaluate and to save, in evaluation mode."""
        return self.averaged if self.config.ema is not None else self.network.eval()

    def _train(self, batch: Batch) -> StepRecord:
        config, progress = self.config, self.progress
        rate = learning_rate(config, self.step, progress)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.network.train()
        self.whole = False
        kept = [buffer.clone() for buffer in self.network.buffers()]
        batch = to_device(batch, self.device)
        with half_precision(self.device, config.bf16):
            outputs: PointOutputs = self._parallel(batch.inputs)
        terms = self._terms(outputs, batch)
        total = sum((weight * term for weight, term in terms.values()), torch.zeros((), device=self.device))
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()  # type: ignore[no-untyped-call]
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), config.clip or math.inf)
        finite = bool(torch.isfinite(norm))  # all processes share the gradient, so they decide alike
        if finite:
            self.optimizer.step()
            self._average()
        else:  # the forward pass has changed the statistics of the normalisation
            for buffer, before in zip(self.network.buffers(), kept, strict=True):
                buffer.copy_(before)
        self._count_skips(finite)
        self.step += 1
        self.whole = True
        losses = {name: float(term.detach()) for name, (_, term) in terms.items()} | {"total": float(total.detach())}
        return StepRecord(
            step=self.step, progress=progress, losses=losses, learning_rate=rate, norm=float(norm), skipped=not finite
        )

    def _terms(self, outputs: PointOutputs, batch: Batch) -> dict[str, tuple[float, Tensor]]:
        config = self.config
        seed = np.random.SeedSequence([config.seed, self.batches.rank, self.step, 1]).generate_state(1)[0]
        chance = torch.Generator(device=self.device).manual_seed(int(seed))
        ids, embedding = batch.instance_ids_BN, outputs.embedding_BNF.float()
        # A bin of one part has one class: its semantic loss is 0, and no pair is of two classes.
        classes = ids.clamp(max=0) if batch.class_ids_BN is None else batch.class_ids_BN
        pairs = pair_loss(
            embedding,
            ids,
            config.pairs,
            config.alpha(self.epoch),
            attributes=PointAttributes(batch.class_ids_BN, batch.points_BN3),
            generator=chance,
        )
        terms = {
            "pairs": (1.0, pairs),
            "confidence": (
                config.confidence_weight,
                confidence_loss(outputs.confidence_BN.float(), embedding, ids, config.pairs, generator=chance),
            ),
            "semantics": (config.semantic_weight, semantic_loss(outputs.semantics_BNS.float(), classes)),
        }
        if outputs.offsets_BN3 is not None and batch.offsets_BN3 is not None:
            terms["offsets"] = (config.offset_weight, offset_loss(outputs.offsets_BN3, batch.offsets_BN3, ids))
        return terms

    def _average(self) -> None:
        if self.config.ema is None:
            return
        # The first weights are far from the last ones, so the memory of the average grows with the training.
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            theirs = self.network.state_dict()
            for name, mine in self.averaged.state_dict().items():
                if mine.dtype.is_floating_point:
                    mine.lerp_(theirs[name], 1.0 - decay)
                else:
                    mine.copy_(theirs[name])

    def _require_one_step(self) -> None:
        if self.world == 1:
            return
        first = torch.tensor(self.step, device=self.device)
        torch.distributed.broadcast(first, 0)
        if int(first) != self.step:
            raise TrainingError(
                f"process {self.batches.rank} is at step {self.step}, the first one at {int(first)}: "
                "--out must be a folder that all processes share"
            )

    def _count_skips(self, finite: bool) -> None:
        self._skips = 0 if finite else self._skips + 1
        if self._skips > SKIPS:
            raise TrainingError(
                f"loss or gradient was not finite {self._skips} times in a row, the last time at step {self.step}; "
                "a lower learning rate, or clipping, may help"
            )


def learning_rate(config: TrainingConfig, step: int, progress: float) -> float:
    """Return the learning rate of a step: a linear warm-up, then constant or a cosine over the training."""
    rate = config.learning_rate
    if config.schedule == "cosine":
        low = min(config.final_rate, rate)
        rate = low + (rate - low) * 0.5 * (1.0 + math.cos(math.pi * progress))
    return rate * min(1.0, (step + 1) / config.warmup) if config.warmup else rate


def to_device(batch: Batch, device: torch.device) -> Batch:
    """Return a batch on ``device``."""
    inputs = batch.inputs
    moved = inputs.to(device) if isinstance(inputs, Tensor) else type(inputs)(*_moved(inputs, device))
    return Batch(moved, *_moved(batch[1:], device))


def _moved(arrays: Iterable[Tensor | None], device: torch.device) -> list[Any]:
    return [None if array is None else array.to(device) for array in arrays]


def _optimizer(config: TrainingConfig, network: nn.Module) -> torch.optim.Optimizer:
    if config.optimizer == "adam":
        return torch.optim.Adam(network.parameters(), config.learning_rate)
    return torch.optim.AdamW(network.parameters(), config.learning_rate, weight_decay=config.weight_decay)
