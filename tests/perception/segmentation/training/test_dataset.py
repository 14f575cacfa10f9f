"""Training samples: turned, cut and thinned, but of the same parts; the same for the same step."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from perception.segmentation.networks.grid import CHANNELS, FINE
from perception.segmentation.networks.grid_net import GridInputs
from perception.segmentation.scene import SceneError
from perception.segmentation.training.augment import NONE, AugmentConfig, draw_kept, draw_turn
from perception.segmentation.training.dataset import (
    BORDER,
    CROP,
    HIDDEN,
    BatchMaker,
    cloud_sample,
    find_scenes,
    grid_sample,
    load_packed,
    scene_sources,
    split_scenes,
)
from perception.segmentation.training.packed import PackedScene
from tests.perception.disc_scene import D_MAX, disc_scene

SCENE = PackedScene.pack(disc_scene())
SEEDS = range(8)


def maker(kind: str = "grid", augment: AugmentConfig | None = None, rank: int = 0) -> BatchMaker:
    scenes = [PackedScene.pack(disc_scene(seed)) for seed in range(3)]
    return BatchMaker(
        scenes=scenes, kind=kind, batch=2, points=100, augment=augment or AugmentConfig(), seed=5, rank=rank
    )


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("sample", [grid_sample, cloud_sample])
def test_every_point_leads_to_its_parts_centre(sample, seed: int) -> None:
    augment = AugmentConfig(jitter=0.0)
    drawn = sample(SCENE, 300, augment, np.random.default_rng(seed))
    votes = drawn.points + drawn.offsets
    for i in np.unique(drawn.instance_ids[drawn.instance_ids >= 0]):
        mine = votes[drawn.instance_ids == i]
        np.testing.assert_allclose(mine, np.broadcast_to(mine[0], mine.shape), atol=2e-5)
    # The discs' rims lie half a d_max from their centres; their size may be misjudged by `scale`.
    rims = np.linalg.norm(drawn.offsets[drawn.instance_ids >= 0], axis=1)
    assert np.all((rims > 0.5 * 0.91) & (rims < 0.5 * 1.09))  # a pixel is 3 % of a radius


@pytest.mark.parametrize("sample", [grid_sample, cloud_sample])
def test_without_augmentation_the_axes_are_the_cameras(sample) -> None:
    drawn = sample(SCENE, 300, NONE, np.random.default_rng(0))
    votes = (drawn.points + drawn.offsets) * D_MAX
    ids = np.unique(drawn.instance_ids[drawn.instance_ids >= 0])
    found = np.stack([votes[drawn.instance_ids == i][0] for i in ids])
    np.testing.assert_allclose(found - found[0], SCENE.centres[ids] - SCENE.centres[ids[0]], atol=1e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_crop_shows_the_surface_under_its_points(seed: int) -> None:
    drawn = grid_sample(SCENE, 400, AugmentConfig(jitter=0.0, scale=0.0), np.random.default_rng(seed))
    heights = (
        drawn.cells.reshape(4, FINE, FINE, CROP, CROP).transpose(0, 3, 1, 4, 2).reshape(4, FINE * CROP, FINE * CROP)[0]
    )
    at = np.floor(drawn.place * FINE).astype(int)
    parts = drawn.instance_ids >= 0
    own = drawn.local[:, 3]
    # On an outline half of the cells show what lies below; nearby there is the point's own surface nonetheless.
    nearest = np.stack(
        [
            heights[np.clip(at[:, 1] + dv, 0, 255), np.clip(at[:, 0] + du, 0, 255)]
            for dv in range(-3, 4)
            for du in range(-3, 4)
        ]
    )
    assert np.mean(np.abs(nearest - own).min(axis=0)[parts] < 0.01) > 0.9


def test_points_are_taught_away_from_the_crops_rim() -> None:
    drawn = grid_sample(SCENE, 400, AugmentConfig(), np.random.default_rng(1))
    assert drawn.cells.shape == (CHANNELS, CROP, CROP)
    assert drawn.place.min() > BORDER
    assert drawn.place.max() < CROP - BORDER


def test_hidden_parts_are_drawn_more_than_their_share() -> None:
    scene = disc_scene(parts=2, void=0)
    keep = (scene.instance_ids == 0) | (np.arange(320) % 16 == 0)  # 160 points of one, 10 of the other
    drawn = grid_sample(PackedScene.pack(scene.only(keep)), 4000, NONE, np.random.default_rng(0))
    share = np.mean(drawn.instance_ids == 1)
    assert 0.5 * np.sqrt(10) / (np.sqrt(10) + np.sqrt(160)) < share < 0.4


@pytest.mark.parametrize("kind", ["grid", "cloud"])
def test_a_steps_batch_depends_on_seed_rank_and_step_alone(kind: str) -> None:
    first, again, other = maker(kind)(3), maker(kind)(3), maker(kind)(4)
    inputs = first.inputs[0] if isinstance(first.inputs, GridInputs) else first.inputs
    repeat = again.inputs[0] if isinstance(again.inputs, GridInputs) else again.inputs
    assert torch.equal(inputs, repeat)
    assert torch.equal(first.offsets_BN3, again.offsets_BN3)
    assert not torch.equal(first.points_BN3, other.points_BN3)
    assert not torch.equal(first.points_BN3, maker(kind, rank=1)(3).points_BN3)


def test_the_shape_is_told_for_most_crops_of_scenes_that_know_it() -> None:
    scenes = [replace(SCENE, shape=np.full(5, 0.5, np.float32)), SCENE]
    batches = replace(maker(), scenes=scenes, batch=40, points=1)
    chosen = np.random.default_rng(np.random.SeedSequence([5, 0, 0])).integers(2, size=40)
    shape = batches(0).inputs.shape_BS.numpy()
    told = shape[:, 5] == 1
    assert not told[chosen == 1].any()
    assert abs(told[chosen == 0].mean() - (1 - HIDDEN)) < 0.3
    np.testing.assert_array_equal(shape[told], [[0.5] * 5 + [1]] * told.sum())
    assert not shape[~told].any()


def test_fewer_points_than_asked_for_are_repeated() -> None:
    few = PackedScene.pack(disc_scene(parts=1, points_each=7, void=0))
    for sample in (grid_sample, cloud_sample):
        assert sample(few, 50, AugmentConfig(), np.random.default_rng(0)).points.shape == (50, 3)


def test_turns_are_rotations_mirrored_half_of_the_time() -> None:
    rng = np.random.default_rng(0)
    turns = np.stack([draw_turn(AugmentConfig(), rng) for _ in range(200)])
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(2), turns.shape), atol=1e-12)
    assert 60 < np.sum(np.linalg.det(turns) < 0) < 140
    np.testing.assert_array_equal(draw_turn(NONE, rng), np.eye(2))


def test_patches_and_thinning_drop_points_and_none_drops_nothing() -> None:
    points = np.random.default_rng(0).random((2000, 3))
    rng = np.random.default_rng(1)
    assert draw_kept(points, 0.3, NONE, rng).all()
    patched = draw_kept(points, 1.0, AugmentConfig(thinning=0.0, patches=20, patch_radius=0.3), rng)
    assert 0 < np.mean(patched) < 1
    assert len(draw_kept(points[:0], 0.3, AugmentConfig(), rng)) == 0


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("jitter", -1.0, "jitter must not be negative, got -1.0"),
        ("patch_radius", -0.1, "patch_radius must not be negative"),
        ("scale", 1.0, r"scale must be in \[0, 1\), got 1.0"),
        ("thinning", 1.5, r"thinning must be in \[0, 1\)"),
        ("patches", -1, "patches must not be negative, got -1"),
    ],
)
def test_nonsense_augmentation_is_named(field: str, value: float, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        AugmentConfig(**{field: value})


def test_held_out_scenes_are_the_first_and_stay_the_same(tmp_path: Path) -> None:
    folders = [tmp_path / "a", tmp_path / "b"]
    for k in range(5):
        disc_scene(parts=1, points_each=5).save(folders[0] / f"scene_{k:05d}.npz")
    disc_scene(parts=1, points_each=5).save(folders[1] / "scene_00000.npz")
    (folders[0] / "scenes.json").write_text('{"part": "nut", "seed": 4, "backend": "raster"}')
    training, validation = split_scenes(folders, [], 2)
    assert [path.name for path in validation] == ["scene_00000.npz", "scene_00001.npz"]
    assert len(training) == 4
    disc_scene(parts=1, points_each=5).save(folders[0] / "scene_00005.npz")
    assert split_scenes(folders, [], 2)[1] == validation
    assert split_scenes(folders[:1], folders[1:], 2)[1] == find_scenes(folders[1:])
    with pytest.raises(ValueError, match="held_out must not be negative, got -1"):
        split_scenes(folders, [], -1)
    known, unknown = scene_sources(training)
    assert (known["part"], known["seed"], known["scenes"]) == ("nut", 4, 3)
    assert (unknown["part"], unknown["scenes"]) == (None, 1)


def test_folders_are_read_and_damaged_files_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    disc_scene().save(tmp_path / "scene_00000.npz")
    (tmp_path / "scene_00001.npz").write_bytes(b"half a file")
    disc_scene(parts=0, void=5).save(tmp_path / "scene_00002.npz")  # nothing to learn
    paths = find_scenes([tmp_path])
    calls: list[int] = []
    scenes = load_packed(paths, lambda: calls.append(1))
    assert (len(paths), len(scenes), len(calls)) == (3, 1, 3)
    assert "left out" in caplog.text
    np.testing.assert_allclose(scenes[0].points, SCENE.points, atol=1e-6)
    assert scenes[0].name == f"{tmp_path.name}/scene_00000.npz"
    with pytest.raises(SceneError, match="none of 1 files holds a scene to learn from"):
        load_packed(paths[1:2])
    with pytest.raises(FileNotFoundError, match=r"holds no scene_\*.npz; make them with"):
        find_scenes([tmp_path / "nowhere"])
