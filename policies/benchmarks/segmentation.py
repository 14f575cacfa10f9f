"""Speed of segmentation: scenes, a frame from pixels to labels, and training steps with and without each saving."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import torch

from binpick_env.scenes.synthesis import SceneConfig, make_scene
from perception.boundary import extract_boundary
from perception.runtime.threads import one_core
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.surface import coarse_surface
from perception.segmentation.training.dataset import BatchMaker
from perception.segmentation.training.loop import Length, StepRecord, Trainer
from perception.segmentation.training.losses import PairLossConfig
from perception.segmentation.training.packed import PackedScene
from perception.segmentation.training.presets import PRESETS, TrainingConfig
from policies.benchmarks.measurement import Measurement, repeat, seconds

CLOUDS, POINTS = 4, 1024  # clouds per training step and points per cloud, the same in every row


def bench_segmentation(config: SceneConfig, repeats: int, threads: int) -> Iterator[Measurement]:
    """Measure segmentation; scenes are made on one core. Each row is yielded as it is measured.

    Args:
        config: Scenes of a part with weights.
        repeats: Number of samples in each row.
        threads: Number of torch's threads.

    Raises:
        ValueError: There is no such part, or a number is not positive.
        WeightsError: The part has no weights.
    """
    if repeats < 1 or threads < 1:
        raise ValueError(f"repeats and threads must be at least 1, got {repeats} and {threads}")
    predictor = SegmentationPredictor.for_part(config.options().load_part().model, device="cpu")
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        yield from _frame(config, repeats, predictor)
        yield from _training(config, repeats)
    finally:
        torch.set_num_threads(before)


def _frame(config: SceneConfig, repeats: int, predictor: SegmentationPredictor) -> Iterator[Measurement]:
    with one_core():
        scene, capture = make_scene(config, 0)
        yield repeat("labelled scene, made", "s", lambda k: seconds(lambda: make_scene(config, 1 + k)), repeats)
    workspace, frame = config.cell().bin.workspace(), capture.frame
    bound = partial(extract_boundary, frame, workspace)
    cells = partial(coarse_surface, frame, workspace, scene.d_max)
    describe = partial(predictor.describe, scene.boundary, scene.surface, scene.d_max)
    predict = partial(predictor.predict, scene.boundary, scene.surface, scene.d_max)

    def whole() -> None:
        predictor.predict(bound(), cells(), scene.d_max)

    whole()  # compiles kernels
    rows: dict[str, Callable[[], object]] = {
        "boundary points": bound,
        "surface in cells": cells,
        "network": describe,
        "network and grouping": predict,
        "frame to labelled boundary points": whole,
    }
    for name, call in rows.items():
        yield repeat(name, "ms", partial(_milliseconds, call), repeats)


def _milliseconds(call: Callable[[], object], _: int) -> float:
    return 1000 * seconds(call)


def _clouds_a_second(steps: Iterator[StepRecord], _: int) -> float:
    return CLOUDS / seconds(lambda: next(steps))


def _training(config: SceneConfig, repeats: int) -> Iterator[Measurement]:
    scenes = [PackedScene.pack(make_scene(config, k).scene) for k in range(2)]
    for name, training in training_rows().items():
        batches = BatchMaker.of(training, scenes)
        trainer = Trainer(training, batches, Length(steps=repeats + 1))
        steps = trainer.run()
        next(steps)  # compiles, allocates
        yield repeat(f"training, {name}", "clouds/s", partial(_clouds_a_second, steps), repeats)


def training_rows() -> dict[str, TrainingConfig]:
    """Return the trainings that are timed: the paper's, then with one more saving each, and ours."""
    all_pairs = replace(PRESETS["paper"], batch=CLOUDS, points=POINTS)
    anchored = replace(all_pairs, pairs=PairLossConfig(anchors=256))
    halved = replace(anchored, bf16=True)
    small = replace(halved, network=SgpnConfig(trunk="dgcnn", k=10, global_width=512))
    reused = replace(halved, network=SgpnConfig(trunk="dgcnn", k=10, global_width=512, reuse_graph=True))
    return {
        "DGCNN, all pairs, fp32": all_pairs,
        "256 anchors": anchored,
        "and bf16": halved,
        "and k = 10, 512 global features": small,
        "and one graph for all layers": reused,
        "ours (crops of 128 x 128 cells)": replace(PRESETS["ours"], batch=CLOUDS, points=POINTS),
    }
