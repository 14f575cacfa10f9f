"""MaskablePPO's policy over `SelectorNet`, whose logits and value are used as they are."""

from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor, nn

from policies.selection.candidate_generator import ROWS
from policies.selection.network import SelectorNet, SelectorNetConfig


class SelectorExtractor(BaseFeaturesExtractor):
    """Concatenates the network's K logits and its value."""

    def __init__(self, observation_space: spaces.Dict, net: SelectorNetConfig | None = None) -> None:
        super().__init__(observation_space, features_dim=ROWS + 1)
        self.network = SelectorNet(net)

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Return (B, K + 1): the logits, then the value."""
        logits_BK, value_B = self.network(observations["grasps"], observations["mask"])
        return torch.cat([logits_BK, value_B[:, None]], dim=1)


class SelectorPolicy(MaskableMultiInputActorCriticPolicy):
    """Uses the extractor's columns as logits and value; a layer over them would depend on the order of rows."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        fixed = {"features_extractor_class": SelectorExtractor, "net_arch": [], "ortho_init": False}
        super().__init__(*arguments, **{**settings, **fixed})

    @property
    def network(self) -> SelectorNet:
        """The network that is trained."""
        extractor = self.features_extractor
        assert isinstance(extractor, SelectorExtractor)
        return extractor.network

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = _Columns(0, ROWS)
        self.value_net = _Columns(ROWS, ROWS + 1)  # type: ignore[assignment]
        self.optimizer = torch.optim.Adam(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


class _Columns(nn.Module):
    """Selects the columns from ``first`` up to, but not including, ``end``."""

    def __init__(self, first: int, end: int) -> None:
        super().__init__()
        self._first, self._end = first, end

    def forward(self, features: Tensor) -> Tensor:
        return features[:, self._first : self._end]
