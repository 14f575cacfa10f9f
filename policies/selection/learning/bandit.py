"""A contextual bandit fitted to logged attempts, which costs far less than PPO: it predicts which grasps deliver."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from perception.geometry import Floats
from policies.selection.learning.experience import Attempts
from policies.selection.learning.record_keys import BANDIT_KEYS, with_former_keys
from policies.selection.network import SelectorNet, SelectorNetConfig

Indices = NDArray[np.int64]
LossName = Literal["delivery", "choice"]


@dataclass(frozen=True, kw_only=True)
class BanditConfig:
    """Loss, network and optimiser of the fit.

    The ``delivery`` loss is the cross-entropy of whether an attempt delivers. The ``choice`` loss compares pairs of
    attempts from one state, one of which delivered and one of which failed (Bradley and Terry's model). The difficulty
    of the bin cancels out of a pair, whereas ``delivery`` has to learn it.
    """

    loss: LossName = "delivery"
    network: SelectorNetConfig = field(default_factory=SelectorNetConfig)
    epochs: int = 60  # passes over the attempts
    batch_size: int = 256  # attempts, or pairs of attempts, per gradient step
    learning_rate: float = 1e-3  # step size of AdamW
    weight_decay: float = 1e-2  # weight decay of AdamW
    held_out: float = 0.2  # share of the bins that the fit is evaluated on instead

    def __post_init__(self) -> None:
        if self.loss not in get_args(LossName):
            raise ValueError(f"loss must be one of {', '.join(get_args(LossName))}, got {self.loss!r}")
        if self.epochs < 1 or self.batch_size < 1:
            raise ValueError(f"epochs and batch_size must be at least 1, got {self.epochs} and {self.batch_size}")
        if not (self.learning_rate > 0 and self.weight_decay >= 0):
            raise ValueError(
                f"learning_rate must be positive and weight_decay not negative, got {self.learning_rate} "
                f"and {self.weight_decay}"
            )
        if not 0 <= self.held_out < 1:
            raise ValueError(f"held_out must be in [0, 1), got {self.held_out}")

    def record(self) -> dict[str, Any]:
        """Return the settings for a selector's record, under their present and their former names."""
        return with_former_keys(asdict(self), BANDIT_KEYS)


@dataclass(frozen=True, kw_only=True)
class Epoch:
    """Quality of the fit after one pass over the attempts; losses are mean cross-entropies.

    Attributes:
        epoch: Number of the pass, from 1.
        loss: Mean loss over the fitted attempts, or pairs of attempts, during the pass.
        held_out: Mean loss over the held-out ones after the pass; NaN if there are none.
        base: Loss of a trivial predictor on the held-out ones: the mean delivery rate of the fitted attempts, or a fair
            coin between the two attempts of a pair.
        auc: Share of the pairs of a delivered and a failed held-out attempt that the logits order correctly; NaN
            without pairs.
        within: The same share over pairs from one state, which are the choices that a selector faces; NaN without
            pairs.
    """

    epoch: int
    loss: float
    held_out: float
    base: float
    auc: float
    within: float

    def __str__(self) -> str:
        """Describe the fit on the held-out bins."""
        if np.isnan(self.held_out):
            return "too few attempts to judge; log more bins"
        fit = f"cross-entropy {self.held_out:.3f} (to beat: {self.base:.3f})"
        if np.isnan(self.auc):
            return f"{fit}; too few attempts for an AUC, which needs a delivered and a failed one"
        within = "unknown: too few attempts" if np.isnan(self.within) else f"{self.within:.3f}"
        return f"{fit}, AUC {self.auc:.3f} (within states {within})"


def fit_bandit(
    attempts: Attempts, config: BanditConfig, seed: int, on_epoch: Callable[[Epoch], None] | None = None
) -> SelectorNet:
    """Fit a network whose logits are those of delivery; the same attempts and seed give the same network.

    Under the ``choice`` loss the logits order the grasps of one state, but give no probability of delivery.

    Args:
        attempts: Logged attempts.
        config: Network, loss and optimiser.
        seed: Seed of initial weights, order of the attempts and held-out bins.
        on_epoch: Callback with the quality of the fit, called after each pass.

    Raises:
        ValueError: The loss is ``choice`` and no state has both a delivered and a failed attempt.
    """
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = SelectorNet(config.network)
    fitted, held_out = _split(attempts, config.held_out, seed)
    examples, unseen = (_examples(attempts, idx.numpy(), config.loss) for idx in (fitted, held_out))
    if not len(examples):
        raise ValueError("loss choice needs states with a delivered and a failed attempt: log several tries from each")
    optimiser = torch.optim.AdamW(network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
    grasps, mask = torch.from_numpy(attempts.grasps), torch.from_numpy(attempts.mask)
    chosen, sign = torch.from_numpy(attempts.chosen), torch.from_numpy(np.where(attempts.delivered, 1.0, -1.0)).float()

    def true_logits(examples: torch.Tensor) -> torch.Tensor:
        """Return the (N,) logits of the true outcomes of (N, 1) attempts, or of the true order of (N, 2) pairs."""
        logits: torch.Tensor = network(grasps[examples[:, 0]], mask[examples[:, 0]])[0]
        return (logits.gather(1, chosen[examples]) * sign[examples]).sum(dim=1)

    for epoch in range(1, config.epochs + 1):
        losses = []
        for batch in torch.split(examples[torch.randperm(len(examples), generator=generator)], config.batch_size):
            loss = nn.functional.softplus(-true_logits(batch)).mean()
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            losses.append(loss.item() * len(batch))
        if on_epoch is not None:
            with torch.no_grad():
                unseen_loss = nn.functional.softplus(-true_logits(unseen).double()).mean().item()  # NaN without any
                logits = (true_logits(held_out[:, None]) * sign[held_out]).double().numpy()
            base = _base(attempts, fitted.numpy(), held_out.numpy()) if config.loss == "delivery" else float(np.log(2))
            auc, within = ranking(logits, attempts, held_out.numpy())
            mean = sum(losses) / len(examples)
            on_epoch(Epoch(epoch=epoch, loss=mean, held_out=unseen_loss, base=base, auc=auc, within=within))
    return network.eval()


def ranking(logits: Floats, attempts: Attempts, idx: Indices) -> tuple[float, float]:
    """Return the AUC over all pairs of attempts, and over pairs from one state; NaN without pairs.

    Args:
        logits: (N,) predicted logits of delivery.
        attempts: Logged attempts.
        idx: (N,) indices of the predicted ones among them.
    """
    delivered = attempts.delivered[idx]
    good, bad = logits[delivered][:, None], logits[~delivered]
    in_order = (good > bad) + 0.5 * (good == bad)
    within = in_order[_one_state(attempts, idx[delivered], idx[~delivered])]
    return _mean(in_order), _mean(within)


def _examples(attempts: Attempts, idx: Indices, loss: LossName) -> torch.Tensor:
    """Return ``idx`` as (N, 1), or the (N, 2) pairs among them of a delivered and a failed attempt from one state."""
    if loss == "delivery":
        return torch.from_numpy(idx[:, None])
    delivered = attempts.delivered[idx]
    good, bad = np.nonzero(_one_state(attempts, idx[delivered], idx[~delivered]))
    return torch.from_numpy(np.stack([idx[delivered][good], idx[~delivered][bad]], axis=1))


def _one_state(attempts: Attempts, a: Indices, b: Indices) -> NDArray[np.bool_]:
    """Return an (A, B) mask of the pairs of attempts that were made from one state."""
    bins, states = attempts.bins, attempts.states
    same: NDArray[np.bool_] = (bins[a][:, None] == bins[b]) & (states[a][:, None] == states[b])
    return same


def _split(attempts: Attempts, share: float, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the indices of attempts in fitted and in held-out bins; a single bin is fitted."""
    bins = np.random.default_rng([seed, 2]).permutation(np.unique(attempts.bins))
    held = np.isin(attempts.bins, bins[: min(round(share * len(bins)), len(bins) - 1)])
    return torch.from_numpy(np.flatnonzero(~held)), torch.from_numpy(np.flatnonzero(held))


def _base(attempts: Attempts, fitted: Indices, held_out: Indices) -> float:
    """Return the cross-entropy on held-out attempts of predicting the mean delivery rate of the fitted ones."""
    rate = np.clip(attempts.delivered[fitted].mean(), 1e-3, 1 - 1e-3)
    return _mean(-np.log(np.where(attempts.delivered[held_out], rate, 1 - rate)))


def _mean(values: Floats) -> float:
    return float(values.mean()) if values.size else float("nan")
