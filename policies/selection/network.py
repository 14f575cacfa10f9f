"""Network of a selector: a logit for each grasp candidate and a value of the state, whatever the order of rows.

Shapes: B observations, K rows, F features of an observation, C of them that are used, H hidden units, S numbers that
summarise all rows.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from policies.selection.features import FEATURES, column

_NEVER = -1e8  # logit of an empty row


@dataclass(frozen=True, kw_only=True)
class SelectorNetConfig:
    """Sizes of the network."""

    features: tuple[str, ...] = tuple(FEATURES)  # names of the features that are used
    hidden: int = 64  # units per layer; 0 is logistic regression, a weighted sum of the features
    context: bool = True  # whether a row's logit depends on the other rows

    def __post_init__(self) -> None:
        if not self.features:
            raise ValueError("features must name at least one column")
        for name in self.features:
            column(name)
        if self.hidden < 0:
            raise ValueError(f"hidden must not be negative, got {self.hidden}")


class SelectorNet(nn.Module):
    """An MLP per row, the masked mean and maximum over rows as context, and an MLP over both."""

    def __init__(self, config: SelectorNetConfig | None = None) -> None:
        super().__init__()
        self.config = config or SelectorNetConfig()
        count, hidden = len(self.config.features), self.config.hidden
        columns = torch.tensor([column(name) for name in self.config.features])
        self._columns: Tensor
        self.register_buffer("_columns", columns, persistent=False)
        self.rows: nn.Module = nn.Identity()
        width = count
        if hidden:
            self.rows = nn.Sequential(nn.Linear(count, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
            width = hidden
        self.score = _head(width * (3 if hidden and self.config.context else 1), hidden)
        self.value = _head(2 * width, hidden)
        self.float()  # whatever torch's default type is in the caller's program

    def forward(self, rows_BKF: Tensor, mask_BK: Tensor) -> tuple[Tensor, Tensor]:
        """Return the logits (B, K) of the rows and the values (B,) of the states.

        Args:
            rows_BKF: Features; those of empty rows have no effect.
            mask_BK: Non-zero for rows that hold a candidate.
        """
        held_BK1 = (mask_BK > 0)[..., None]
        inner_BKH = self.rows(rows_BKF[..., self._columns])
        summary_BS = _summary(inner_BKH, held_BK1)
        joint = inner_BKH
        if self.config.hidden and self.config.context:
            spread = summary_BS[:, None].expand(-1, inner_BKH.shape[1], -1)
            joint = torch.cat([inner_BKH, spread], dim=-1)
        logits_BK = self.score(joint)[..., 0].masked_fill(~held_BK1[..., 0], _NEVER)
        return logits_BK, self.value(summary_BS)[..., 0]


def _head(width: int, hidden: int) -> nn.Module:
    if not hidden:
        return nn.Linear(width, 1)
    return nn.Sequential(nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, 1))


def _summary(inner_BKH: Tensor, held_BK1: Tensor) -> Tensor:
    """Return mean and maximum over the rows that hold a candidate, (B, 2 H); 0 if no row does."""
    kept = inner_BKH.masked_fill(~held_BK1, 0.0)
    count = held_BK1.sum(dim=1)
    mean = kept.sum(dim=1) / count.clamp(min=1)
    largest = inner_BKH.masked_fill(~held_BK1, -torch.inf).amax(dim=1)
    return torch.cat([mean, largest.masked_fill(count == 0, 0.0)], dim=-1)
