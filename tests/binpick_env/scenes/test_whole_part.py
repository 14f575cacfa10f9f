"""How many boundary points a whole part has: by hand for a block, for other cameras, and from the cache."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.config import CameraConfig
from binpick_env.parts import Part, load_part
from binpick_env.scenes import whole_part
from binpick_env.scenes.whole_part import whole_part_points

CAMERA = CameraConfig(width=320, height=240)  # focal length of 600 px


@pytest.fixture(autouse=True)
def few_views(cache: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Use six views instead of 26, and an empty cache."""
    monkeypatch.setattr(whole_part, "_VIEWS", 6)
    whole_part_points.cache_clear()
    yield
    whole_part_points.cache_clear()


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, CameraConfig]]:
    """Calls of `_count`, which renders nothing and returns fixed numbers."""
    asked: list[tuple[str, CameraConfig]] = []

    def count(part: Part, camera: CameraConfig) -> np.ndarray:
        asked.append((part.model.name, camera))
        return np.array([40.0, 100.0, 70.0])

    monkeypatch.setattr(whole_part, "_count", count)
    return asked


@pytest.mark.slow
def test_a_block_has_the_pixels_of_its_outlines(tmp_path: Path, cache: Path) -> None:
    sides = np.array([0.08, 0.05, 0.03])
    mesh = trimesh.creation.box(sides)
    mesh.apply_translation((0.05, -0.02, 0.01))  # its drawing's origin is not its centre
    mesh.export(tmp_path / "block.stl")
    camera = CameraConfig(width=640, height=480)
    counts = whole_part._count(load_part(str(tmp_path / "block.stl"), unit="m"), camera)
    assert len(counts) == 6
    # Seen along z, -z, x, -x, y, -y: the perimeter of the face towards the camera.
    for view, axis in enumerate((2, 2, 0, 0, 1, 1)):
        perimeter = 2 * np.delete(sides, axis).sum()
        depth = camera.distance - whole_part._HEIGHT - sides[axis] / 2
        assert counts[view] == pytest.approx(perimeter * camera.focal_px / depth, rel=0.06), view


def test_a_nearer_camera_sees_more_points_in_proportion() -> None:
    tee = load_part("tee")
    far = whole_part._count(tee, CAMERA)
    assert 100 < far.min() < 0.8 * far.max()
    assert whole_part_points("tee", None, CAMERA) == pytest.approx(far.max() * (0.9 - 0.07))
    near = whole_part_points("tee", None, CameraConfig(width=320, height=240, distance=0.75))
    assert near / 0.68 > 1.15 * far.max()
    assert near == pytest.approx(far.max() * 0.83, rel=0.15)  # an edge is a little sharper in it


def test_it_is_the_largest_count_by_the_depth_it_was_made_at(counted: list[tuple[str, CameraConfig]]) -> None:
    assert whole_part_points("tee", None, CAMERA) == pytest.approx(100.0 * 0.83)
    assert counted == [("tee", CAMERA)]


def test_a_count_is_cached_on_disk(cache: Path, counted: list[tuple[str, CameraConfig]]) -> None:
    first = whole_part_points("tee", None, CAMERA)
    assert len(list(cache.glob("whole-part-*.npz"))) == 1
    whole_part_points.cache_clear()
    assert whole_part_points("tee", None, CAMERA) == first
    assert len(counted) == 1


def test_another_part_or_camera_is_counted(counted: list[tuple[str, CameraConfig]]) -> None:
    others = [
        ("bracket", CAMERA),
        ("tee", replace(CAMERA, distance=0.8)),
        ("tee", replace(CAMERA, width=300)),
        ("tee", replace(CAMERA, focal=2000.0)),
    ]
    for part, camera in [("tee", CAMERA), *others]:
        whole_part_points.cache_clear()
        whole_part_points(part, None, camera)
    assert counted == [("tee", CAMERA), *others]


def test_a_count_is_cached_in_memory(cache: Path, counted: list[tuple[str, CameraConfig]]) -> None:
    first = whole_part_points("tee", None, CAMERA)
    for path in cache.iterdir():
        path.unlink()
    assert whole_part_points("tee", None, CAMERA) == first
    assert len(counted) == 1
