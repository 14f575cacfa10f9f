"""A small evaluation: scenes of few parts, networks without training, and a summary of few resamples."""

from pathlib import Path

import numpy as np
import torch

from binpick_env.config import CameraConfig
from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig
from binpick_env.evaluation.segmentation.summary import SegmentationSummary, load_scores, summarise
from binpick_env.scenes.synthesis import SceneConfig
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.networks.sgpn import Sgpn, SgpnConfig

SCENES = SceneConfig(part="tee", seed=7, num_parts=(3, 4), camera=CameraConfig(width=640, height=480))


def tiny_grid() -> GridNet:
    torch.manual_seed(0)
    return GridNet(GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=4))


def tiny_sgpn() -> Sgpn:
    torch.manual_seed(0)
    return Sgpn(SgpnConfig(trunk="pointnet", embedding=8, branch=8, global_width=16))


def summary_of(config: EvaluationConfig, folder: Path, count: int) -> SegmentationSummary:
    return summarise(config, load_scores(folder, count), np.random.default_rng(0), resamples=50)
