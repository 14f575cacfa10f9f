"""Trainings of the ablation's networks, as small as they can be."""

from dataclasses import replace

from binpick_env.evaluation.segmentation.ablation import BUDGET, Network, trainings
from perception.segmentation.networks.grid_net import GridNetConfig
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.training.loop import TrainingConfig

POINT = SgpnConfig(trunk="pointnet", embedding=8, branch=8, global_width=16)
GRAPH = SgpnConfig(trunk="dgcnn", embedding=8, branch=8, global_width=16, k=4)
GRID = GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=4)


def tiny_trainings() -> dict[Network, TrainingConfig]:
    """Return the trainings with few points and narrow networks."""
    networks = {"sgpn": POINT, "dgcnn": GRAPH, "focal": GRAPH, "ours": GRID}
    small = trainings(replace(BUDGET, batch=2, points=128))
    return {name: replace(config, network=networks[name]) for name, config in small.items()}
