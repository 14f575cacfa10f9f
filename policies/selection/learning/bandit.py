"""The cheap second, a contextual bandit fitted to logged attempts: will this grasp be delivered, or which sooner?"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from perception.geometry import Floats
from policies.selection.learning.experience import Attempts
from policies.selection.network import SelectorNet, SelectorNetConfig

Indices = NDArray[np.int64]
LossName = Literal["delivery", "choice"]


@dataclass(frozen=True, kw_only=True)
class BanditConfig:
    """How the network is fitted.

    ``delivery`` asks of each attempt whether it delivers. ``choice`` asks of each two from one state, of which one
    delivered, which one (Bradley and Terry's model): how hard the bin is cancels out, which delivery has to learn.
    """

    loss: LossName = "delivery"
    network: SelectorNetConfig = field(default_factory=SelectorNetConfig)
    epochs: int = 60  # passes over the attempts
    batch: int = 256  # attempts, or pairs of them, of a step
    rate: float = 1e-3  # Adam's
    decay: float = 1e-2  # of the weights
    held_out: float = 0.2  # share of the bins that the fit is judged on

    def __post_init__(self) -> None:
        if self.loss not in get_args(LossName):
            raise ValueError(f"loss must be one of {', '.join(get_args(LossName))}, got {self.loss!r}")
        if self.epochs < 1 or self.batch < 1:
            raise ValueError(f"epochs and batch must be at least 1, got {self.epochs} and {self.batch}")
        if not (self.rate > 0 and self.decay >= 0):
            raise ValueError(f"rate must be positive and decay not negative, got {self.rate} and {self.decay}")
        if not 0 <= self.held_out < 1:
            raise ValueError(f"held_out must be in [0, 1), got {self.held_out}")


@dataclass(frozen=True, kw_only=True)
class Epoch:
    """How well the fit does after a pass; losses are mean cross-entropies of attempts, or of pairs.

    Attributes:
        epoch: From 1.
        loss: Over the attempts it was fitted to, while it was.
        held_out: Over the others; NaN if there are none.
        base: What is to be beaten there: of the fitted attempts' mean rate, or of a coin that chooses.
        auc: Share of pairs of a delivered and a failed attempt, of the others, that it puts in the right order; NaN
            without pairs.
        within: Likewise of pairs from one state, between which a selector has to choose.
    """

    epoch: int
    loss: float
    held_out: float
    base: float
    auc: float
    within: float

    def __str__(self) -> str:
        """Say how well it does on the held-out bins."""
        fit = f"cross-entropy {self.held_out:.3f} (to beat: {self.base:.3f})"
        return f"{fit}, AUC {self.auc:.3f} (within states {self.within:.3f})"


def fit_bandit(
    attempts: Attempts, config: BanditConfig, seed: int, on_epoch: Callable[[Epoch], None] | None = None
) -> SelectorNet:
    """Return the network whose logits are those of delivery; same attempts and seed, same network.

    Those of ``choice`` say which grasp of a state is likelier to be delivered, not how likely.

    Args:
        attempts: Logged.
        config: Of network and fit.
        seed: Of weights, order and held-out bins.
        on_epoch: Called after each pass.

    Raises:
        ValueError: ``choice`` has nothing to choose between: no state with a delivered and a failed attempt.
    """
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = SelectorNet(config.network)
    fitted, others = _split(attempts, config.held_out, seed)
    examples, unseen = (_examples(attempts, idx.numpy(), config.loss) for idx in (fitted, others))
    if not len(examples):
        raise ValueError("choice needs states with a delivered and a failed attempt: log several tries from each")
    optimiser = torch.optim.AdamW(network.parameters(), lr=config.rate, weight_decay=config.decay)
    grasps, mask = torch.from_numpy(attempts.grasps), torch.from_numpy(attempts.mask)
    chosen, sign = torch.from_numpy(attempts.chosen), torch.from_numpy(np.where(attempts.delivered, 1.0, -1.0)).float()

    def right(examples: torch.Tensor) -> torch.Tensor:
        """Return (N,) logits of the truth about (N, 1) attempts, or (N, 2) pairs of them."""
        every: torch.Tensor = network(grasps[examples[:, 0]], mask[examples[:, 0]])[0]
        return (every.gather(1, chosen[examples]) * sign[examples]).sum(dim=1)

    for epoch in range(1, config.epochs + 1):
        losses = []
        for part in torch.split(examples[torch.randperm(len(examples), generator=generator)], config.batch):
            loss = nn.functional.softplus(-right(part)).mean()
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            losses.append(loss.item() * len(part))
        if on_epoch is not None:
            with torch.no_grad():
                held_out = nn.functional.softplus(-right(unseen).double()).mean().item()  # NaN of none
                logits = (right(others[:, None]) * sign[others]).double().numpy()
            base = _base(attempts, fitted.numpy(), others.numpy()) if config.loss == "delivery" else float(np.log(2))
            auc, within = ranking(logits, attempts, others.numpy())
            mean = sum(losses) / len(examples)
            on_epoch(Epoch(epoch=epoch, loss=mean, held_out=held_out, base=base, auc=auc, within=within))
    return network.eval()


def ranking(logits: Floats, attempts: Attempts, idx: Indices) -> tuple[float, float]:
    """Return AUC and AUC within states of the attempts ``idx`` (N,) with ``logits`` (N,); NaN without pairs."""
    won = attempts.delivered[idx]
    good, bad = logits[won][:, None], logits[~won]
    right = (good > bad) + 0.5 * (good == bad)
    within = right[_one_state(attempts, idx[won], idx[~won])]
    return _mean(right), _mean(within)


def _examples(attempts: Attempts, idx: Indices, loss: LossName) -> torch.Tensor:
    """Return (N, 1) the attempts ``idx``, or (N, 2) the pairs of a delivered and a failed one from one state."""
    if loss == "delivery":
        return torch.from_numpy(idx[:, None])
    won = attempts.delivered[idx]
    good, bad = np.nonzero(_one_state(attempts, idx[won], idx[~won]))
    return torch.from_numpy(np.stack([idx[won][good], idx[~won][bad]], axis=1))


def _one_state(attempts: Attempts, a: Indices, b: Indices) -> NDArray[np.bool_]:
    """Return (A, B) whether two attempts were made from one state."""
    bins, states = attempts.bins, attempts.states
    same: NDArray[np.bool_] = (bins[a][:, None] == bins[b]) & (states[a][:, None] == states[b])
    return same


def _split(attempts: Attempts, share: float, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the indices of attempts to fit to and of those in held-out bins; with a single bin all are fitted."""
    bins = np.random.default_rng([seed, 2]).permutation(np.unique(attempts.bins))
    held = np.isin(attempts.bins, bins[: min(round(share * len(bins)), len(bins) - 1)])
    return torch.from_numpy(np.flatnonzero(~held)), torch.from_numpy(np.flatnonzero(held))


def _base(attempts: Attempts, fitted: Indices, others: Indices) -> float:
    """Return the cross-entropy on ``others`` of the mean rate of ``fitted``."""
    rate = np.clip(attempts.delivered[fitted].mean(), 1e-3, 1 - 1e-3)
    return _mean(-np.log(np.where(attempts.delivered[others], rate, 1 - rate)))


def _mean(values: Floats) -> float:
    return float(values.mean()) if values.size else float("nan")
