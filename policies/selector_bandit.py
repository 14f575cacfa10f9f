"""The cheap second, a contextual bandit: will this grasp be delivered? Fitted to logged attempts."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import nn

from policies.selector_experience import Attempts
from policies.selector_net import SelectorNet, SelectorNetConfig


@dataclass(frozen=True, kw_only=True)
class BanditConfig:
    """How the network is fitted."""

    network: SelectorNetConfig = field(default_factory=SelectorNetConfig)
    epochs: int = 60  # passes over the attempts
    batch: int = 256  # attempts of a step
    rate: float = 1e-3  # Adam's
    decay: float = 1e-2  # of the weights
    held_out: float = 0.2  # share of the bins that the fit is judged on

    def __post_init__(self) -> None:
        if self.epochs < 1 or self.batch < 1:
            raise ValueError(f"epochs and batch must be at least 1, got {self.epochs} and {self.batch}")
        if not (self.rate > 0 and self.decay >= 0):
            raise ValueError(f"rate must be positive and decay not negative, got {self.rate} and {self.decay}")
        if not 0 <= self.held_out < 1:
            raise ValueError(f"held_out must be in [0, 1), got {self.held_out}")


@dataclass(frozen=True, kw_only=True)
class Epoch:
    """How well the fit does after a pass; losses are mean cross-entropies.

    Attributes:
        epoch: From 1.
        loss: Over the attempts it was fitted to, while it was.
        held_out: Over the others; NaN if there are none.
        base: Of the fitted attempts' mean rate, on the others: what is to be beaten.
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
        fit = f"cross-entropy {self.held_out:.3f} (of the mean rate alone {self.base:.3f})"
        return f"{fit}, AUC {self.auc:.3f} (within states {self.within:.3f})"


def fit_bandit(
    attempts: Attempts, config: BanditConfig, seed: int, on_epoch: Callable[[Epoch], None] | None = None
) -> SelectorNet:
    """Return the network whose logits are those of delivery; same attempts and seed, same network.

    Args:
        attempts: Logged.
        config: Of network and fit.
        seed: Of weights, order and held-out bins.
        on_epoch: Called after each pass.
    """
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = SelectorNet(config.network)
    fitted, others = _split(attempts, config.held_out, seed)
    optimiser = torch.optim.AdamW(network.parameters(), lr=config.rate, weight_decay=config.decay)
    loss_of = nn.BCEWithLogitsLoss()
    grasps, mask = torch.from_numpy(attempts.grasps), torch.from_numpy(attempts.mask)
    chosen, won = torch.from_numpy(attempts.chosen), torch.from_numpy(attempts.delivered).float()

    def logits(idx: torch.Tensor) -> torch.Tensor:
        every: torch.Tensor = network(grasps[idx], mask[idx])[0]
        return every.gather(1, chosen[idx][:, None])[:, 0]

    for epoch in range(1, config.epochs + 1):
        losses = []
        for part in torch.split(fitted[torch.randperm(len(fitted), generator=generator)], config.batch):
            loss = loss_of(logits(part), won[part])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(loss.item() * len(part))
        if on_epoch is not None:
            with torch.no_grad():
                found = logits(others).double().numpy()
            on_epoch(_judged(epoch, sum(losses) / len(fitted), found, attempts, fitted.numpy(), others.numpy()))
    return network.eval()


def _split(attempts: Attempts, share: float, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the indices of attempts to fit to and of those in held-out bins; with a single bin all are fitted."""
    bins = np.random.default_rng([seed, 2]).permutation(np.unique(attempts.bins))
    held = np.isin(attempts.bins, bins[: min(round(share * len(bins)), len(bins) - 1)])
    return torch.from_numpy(np.flatnonzero(~held)), torch.from_numpy(np.flatnonzero(held))


def _judged(
    epoch: int,
    loss: float,
    logits: np.ndarray,
    attempts: Attempts,
    fitted: np.ndarray,
    others: np.ndarray,
) -> Epoch:
    won = attempts.delivered[others]
    mean = np.clip(attempts.delivered[fitted].mean(), 1e-3, 1 - 1e-3)
    return Epoch(
        epoch=epoch,
        loss=loss,
        held_out=_entropy(logits, won),
        base=_entropy(np.full(len(won), np.log(mean / (1 - mean))), won),
        auc=_auc(logits, won),
        within=_auc_within(logits, won, attempts.bins[others], attempts.states[others]),
    )


def _entropy(logits: np.ndarray, won: np.ndarray) -> float:
    return float(np.mean(np.logaddexp(0.0, np.where(won, -logits, logits)))) if len(won) else float("nan")


def _auc_within(logits: np.ndarray, won: np.ndarray, bins: np.ndarray, states: np.ndarray) -> float:
    """Return the share of pairs from one state that are in the right order; NaN without pairs."""
    same = (bins[won][:, None] == bins[~won]) & (states[won][:, None] == states[~won])
    good, bad = logits[won][:, None], logits[~won]
    right = (good > bad) + 0.5 * (good == bad)
    return float(right[same].mean()) if same.any() else float("nan")


def _auc(logits: np.ndarray, won: np.ndarray) -> float:
    good, bad = logits[won], logits[~won]
    if len(good) == 0 or len(bad) == 0:
        return float("nan")
    above = (good[:, None] > bad[None]).mean() + 0.5 * (good[:, None] == bad[None]).mean()
    return float(above)
