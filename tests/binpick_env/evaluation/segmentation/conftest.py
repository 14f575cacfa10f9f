"""Weights of networks without training, and the evaluation of one of them."""

from pathlib import Path

import pytest

from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig
from binpick_env.evaluation.segmentation.method import MethodConfig
from perception.segmentation.weights import save_network
from tests.binpick_env.evaluation.segmentation.small_evaluation import SCENES, tiny_grid, tiny_sgpn


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_network(path, tiny_grid(), {"parts": ["tee"], "git_commit": "abc", "steps": 0})
    return path


@pytest.fixture(scope="module")
def sgpn_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "sgpn.safetensors"
    save_network(path, tiny_sgpn(), {"training": {"pairs": {"distance": "scaled_square"}}})
    return path


@pytest.fixture
def config(weights: Path) -> EvaluationConfig:
    return EvaluationConfig(scenes=SCENES, method=MethodConfig(weights=weights))
