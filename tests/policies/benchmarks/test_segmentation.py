"""The benchmark of segmentation gives every row, each made of positive samples."""

import pytest

from binpick_env.config import CameraConfig
from binpick_env.scenes.synthesis import SceneConfig
from perception.segmentation.training.presets import PRESETS
from policies.benchmarks import segmentation
from policies.benchmarks.segmentation import CLOUDS, POINTS, bench_segmentation, training_rows


def test_rows_of_training_differ_in_one_saving_each() -> None:
    rows = list(training_rows().values())
    assert {(config.batch, config.points) for config in rows} == {(CLOUDS, POINTS)}
    first, anchored, halved = rows[:3]
    assert (first.pairs, first.network) == (PRESETS["paper"].pairs, PRESETS["paper"].network)
    assert (anchored.pairs.anchors, anchored.network, anchored.bf16) == (256, first.network, False)
    assert (halved.pairs, halved.network, halved.bf16) == (anchored.pairs, first.network, True)


@pytest.mark.parametrize(("repeats", "threads"), [(0, 1), (1, 0)])
def test_nonsense_is_refused(repeats: int, threads: int) -> None:
    with pytest.raises(ValueError, match="repeats and threads must be at least 1"):
        next(bench_segmentation(SceneConfig(), repeats, threads))


@pytest.mark.slow
def test_every_row_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segmentation, "CLOUDS", 2)
    monkeypatch.setattr(segmentation, "POINTS", 128)
    scenes = SceneConfig(seed=5, num_parts=(3, 3), camera=CameraConfig(width=480, height=360))
    rows = list(bench_segmentation(scenes, repeats=1, threads=1))
    assert len({row.name for row in rows}) == len(rows) == 6 + len(training_rows())
    assert all(value > 0 for row in rows for value in row.values)
    assert {row.unit for row in rows} == {"s", "ms", "clouds/s"}
