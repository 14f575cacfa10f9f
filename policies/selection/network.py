"""A selector as a network: a score for each grasp on offer, and a value of all; rows may stand in any order.

Shapes: B observations, K rows, F features on offer, C of them that are used, H hidden units, S numbers that
sum up all rows.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from policies.selection.features import FEATURES, column

_NEVER = -1e8  # logit of a row that holds nothing


@dataclass(frozen=True, kw_only=True)
class SelectorNetConfig:
    """Sizes of the network."""

    features: tuple[str, ...] = tuple(FEATURES)  # columns that it uses of a row, by name
    hidden: int = 64  # units of every layer; 0 scores each row by a weighted sum alone: logistic regression
    context: bool = True  # whether a row's score depends on the other rows

    def __post_init__(self) -> None:
        if not self.features:
            raise ValueError("features must name at least one column")
        for name in self.features:
            column(name)
        if self.hidden < 0:
            raise ValueError(f"hidden must not be negative, got {self.hidden}")


class SelectorNet(nn.Module):
    """An MLP over rows, masked mean and maximum as their context, an MLP over both."""

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

    def forward(self, rows_BKF: Tensor, mask_BK: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits (B, K), of each row that holds a grasp, and values (B,).

        Args:
            rows_BKF: Features, anything where there is no grasp.
            mask_BK: Not 0 where there is one.
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
    """Return mean and maximum over the rows that hold a grasp, (B, 2 H); 0 where none does."""
    kept = inner_BKH.masked_fill(~held_BK1, 0.0)
    count = held_BK1.sum(dim=1)
    mean = kept.sum(dim=1) / count.clamp(min=1)
    largest = inner_BKH.masked_fill(~held_BK1, -torch.inf).amax(dim=1)
    return torch.cat([mean, largest.masked_fill(count == 0, 0.0)], dim=-1)
