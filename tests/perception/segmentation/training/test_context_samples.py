"""Samples of the context network: crops of an even density, void near the rim, and offsets to the right centres."""

import numpy as np
import pytest
import torch

from perception.segmentation.networks.context_net import ContextInputs, ContextNetConfig
from perception.segmentation.networks.hierarchy import level_sizes
from perception.segmentation.training.augment import NONE, AugmentConfig
from perception.segmentation.training.context_samples import context_sample
from perception.segmentation.training.dataset import BatchMaker
from perception.segmentation.training.loop import Length, Trainer
from perception.segmentation.training.packed import PackedScene
from perception.segmentation.training.presets import PRESETS, TrainingConfig
from tests.perception.disc_scene import disc_scene

SCENE = PackedScene.pack(disc_scene())
SMALL = ContextNetConfig(k=6, edge_k=4, edge=5, widths=(6, 7, 8), depths=(1, 1, 1), branch=9, embedding=4)


def sample(count: int = 300, augment: AugmentConfig = NONE, seed: int = 0):
    return context_sample(SCENE, count, 0.025, 6, augment, np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(4))
def test_every_point_leads_to_its_parts_centre(seed: int) -> None:
    drawn = sample(augment=AugmentConfig(jitter=0.0), seed=seed)
    votes = drawn.cloud.points + drawn.offsets
    ids = np.unique(drawn.instance_ids[drawn.instance_ids >= 0])
    assert len(ids) > 0
    for i in ids:
        mine = votes[drawn.instance_ids == i]
        np.testing.assert_allclose(mine, np.broadcast_to(mine[0], mine.shape), atol=2e-5)
    rims = np.linalg.norm(drawn.offsets[drawn.instance_ids >= 0], axis=1)
    assert np.all((rims > 0.5 * 0.91) & (rims < 0.5 * 1.09))


def test_a_crop_is_void_near_its_rim_and_a_whole_scene_is_not() -> None:
    whole = sample(2000)
    points = len(np.unique(SCENE.points, axis=0))
    assert len(np.unique(whole.cloud.points, axis=0)) == points  # all of them, and some twice
    void = np.mean(SCENE.instance_ids < 0)
    assert np.mean(whole.instance_ids < 0) == pytest.approx(void, abs=0.03)
    assert np.mean(sample(300).instance_ids < 0) > void + 0.05


def test_a_sparse_scene_is_thinned_less() -> None:
    assert len(np.unique(sample(900).cloud.points, axis=0)) == 900


def test_a_batch_is_the_same_at_every_call() -> None:
    maker = BatchMaker(
        scenes=[SCENE], kind="context", batch=2, points=128, augment=AugmentConfig(), seed=0, context=SMALL
    )
    batch, again = maker(3), maker(3)
    assert isinstance(batch.inputs, ContextInputs)
    assert batch.inputs.fine_BNK.shape == (2, 128, 6)
    assert [each.shape[1] for each in batch.inputs[1:4]] == list(level_sizes(128))
    for one, other in zip(batch.inputs, again.inputs, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


@pytest.mark.slow
def test_the_preset_trains_and_its_loss_falls() -> None:
    torch.set_num_threads(1)
    preset = PRESETS["dgcnn-context"]
    assert preset.kind == "context"
    config = TrainingConfig(
        network=SMALL, pairs=preset.pairs, offset_weight=20.0, batch=2, points=192, warmup=5, learning_rate=0.02
    )
    trainer = Trainer(config, BatchMaker.of(config, [SCENE]), Length(steps=100))
    losses = [record.losses["total"] for record in trainer.run()]
    assert np.mean(losses[-20:]) < 0.7 * np.mean(losses[:20])
