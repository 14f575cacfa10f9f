"""Frames that were written are read again: NPZ bit for bit, images to half a unit."""

from pathlib import Path

import numpy as np
import pytest

from perception.capture import read_frame, write_frame
from perception.frame import Frame
from perception.geometry import make_transform, rotation_about
from tests.perception.capture.camera_files import HEIGHT, WIDTH, K, scene_depth

POSE = make_transform(rotation_about((1, 2, 3), 0.8), (0.1, 0.2, 1.0))


def frame(scale: float = 1.0) -> Frame:
    rng = np.random.default_rng(3)
    depth = scene_depth() * np.float32(scale) * rng.uniform(0.9, 1.1, (HEIGHT, WIDTH)).astype(np.float32)
    return Frame(grey=rng.integers(0, 256, (HEIGHT, WIDTH), np.uint8), depth=depth, K=K, T_world_cam=POSE)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e5])
def test_an_npz_is_exact(tmp_path: Path, scale: float) -> None:
    before = frame(scale)
    write_frame(before, tmp_path / "new" / "a.npz")
    after = read_frame(tmp_path / "new" / "a.npz")
    for name in ("grey", "depth", "K", "T_world_cam"):
        mine, other = getattr(before, name), getattr(after, name)
        assert mine.dtype == other.dtype
        assert mine.tobytes() == other.tobytes(), name
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a.npz"]


@pytest.mark.parametrize("scale", [0.0001, 0.001])
def test_images_are_exact_to_half_a_unit(tmp_path: Path, scale: float) -> None:
    before = frame()
    write_frame(before, tmp_path / "a.json", scale=scale)
    after = read_frame(tmp_path / "a.json")
    np.testing.assert_array_equal(after.grey, before.grey)
    np.testing.assert_array_equal(after.K, before.K)
    np.testing.assert_array_equal(after.T_world_cam, before.T_world_cam)
    np.testing.assert_array_equal(after.valid, before.valid)
    assert np.abs(after.depth - before.depth).max() <= scale / 2 + 1e-7
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a_depth.png", "a_grey.png"]
    again = tmp_path / "b.json"  # whole units stay the same
    write_frame(after, again, scale=scale)
    np.testing.assert_array_equal(read_frame(again).depth, after.depth)


def test_a_frame_without_depth_is_written(tmp_path: Path) -> None:
    empty = Frame(grey=frame().grey, depth=np.zeros((HEIGHT, WIDTH), np.float32), K=K, T_world_cam=POSE)
    write_frame(empty, tmp_path / "a.json")
    assert not read_frame(tmp_path / "a.json").valid.any()


def test_depths_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="must be 1 to 65534 units, got a unit of 1e-05 m: set scale to at least"):
        write_frame(frame(), tmp_path / "a.json", scale=1e-5)
    with pytest.raises(ValueError, match="must be 1 to 65534 units, got a unit of 3 m"):
        write_frame(frame(), tmp_path / "a.json", scale=3.0)
    with pytest.raises(ValueError, match=r"scale must be a positive length \[m\] per unit, got 0"):
        write_frame(frame(), tmp_path / "a.json", scale=0)
    with pytest.raises(ValueError, match=r"path must end in \.npz \(exact\) or \.json .* got 'a\.png'"):
        write_frame(frame(), tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []
