"""A scene's file gives back what was put in, or says that it does not."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perception.boundary import BoundaryCloud
from perception.geometry import camera_matrix, make_transform, random_rotation
from perception.segmentation import scene as scene_module
from perception.segmentation.scene import SURFACE_UNIT, BoundaryScene, SceneError
from perception.segmentation.surface import Surface
from perception.shape import shape_values

PARTS = 4


def facts(points: int = 200, seed: int = 0) -> dict[str, Any]:
    """Return the fields of a random scene; point 0 has no tangent."""
    rng = np.random.default_rng(seed)
    K = camera_matrix(2400.0, 1280, 960) + np.array([[0.0, 0.0, 9.0], [0.0, 80.0, -6.0], [0.0, 0.0, 0.0]])
    flat = np.sort(rng.choice(1280 * 960, size=points, replace=False))
    pixels = np.column_stack([flat % 1280, flat // 1280])
    z = rng.uniform(0.7, 0.95, points).astype(np.float32).astype(np.float64)
    rays = np.column_stack([(pixels - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones(points)])
    tangents = rng.normal(size=(points, 3))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    tangents[:1] = 0.0
    depth = rng.choice([0.0, 0.85, 0.9], size=(30, 40)).astype(np.float32)
    poses = np.stack([make_transform(random_rotation(rng), rng.normal(size=3)) for _ in range(PARTS)])
    return {
        "part": "tee",
        "d_max": 0.0923,
        "boundary": BoundaryCloud(
            points_cam=rays * z[:, None], tangents_cam=tangents, linearity=rng.random(points), pixels=pixels
        ),
        "surface": Surface(depth=depth, u0=310.0, v0=120.0, cell=3.08),
        "K": K,
        "instance_ids": rng.integers(-1, PARTS, points),
        "T_cam_parts": poses,
        "centres_cam": rng.normal(size=(PARTS, 3)),
        "visible_fractions": rng.random(PARTS),
    }


def empty() -> dict[str, Any]:
    """Return the fields of a scene without parts or points."""
    nothing = {"T_cam_parts": np.zeros((0, 4, 4)), "centres_cam": np.zeros((0, 3)), "visible_fractions": np.zeros(0)}
    return facts(0) | nothing


def test_the_shape_is_kept_and_unknown_in_older_files(tmp_path: Path) -> None:
    told = BoundaryScene(**facts(), signature=np.array([0.1, 0.09, 0.04, 0.02, 0.03, 0.03]))
    for scene in (told, BoundaryScene(**facts())):
        scene.save(tmp_path / "scene.npz")
        again = BoundaryScene.load(tmp_path / "scene.npz")
        if scene is told:
            assert again.signature is not None
            np.testing.assert_array_equal(again.signature, told.signature)
            np.testing.assert_array_equal(again.shape, shape_values(told.signature))
        else:
            assert again.signature is None
            assert again.shape is None


# --- there and back --------------------------------------------------------------------------------------------------


def test_a_file_gives_back_the_scene(tmp_path: Path) -> None:
    scene = BoundaryScene(**facts())
    scene.save(tmp_path / "new" / "scene.npz")
    again = BoundaryScene.load(tmp_path / "new" / "scene.npz")
    for name in ("part", "d_max"):
        assert getattr(again, name) == getattr(scene, name)
    for name in ("K", "instance_ids", "T_cam_parts", "centres_cam", "visible_fractions"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scene, name), err_msg=name)
        assert getattr(again, name).dtype == getattr(scene, name).dtype
    assert (again.surface.u0, again.surface.v0, again.surface.cell) == (310.0, 120.0, 3.08)
    np.testing.assert_allclose(again.surface.depth, scene.surface.depth, atol=SURFACE_UNIT / 2 + 1e-7)
    np.testing.assert_array_equal(again.surface.depth == 0, scene.surface.depth == 0)
    assert again.surface.depth.dtype == np.float32


def test_points_come_back_to_the_bit_and_tangents_to_half_a_degree(tmp_path: Path) -> None:
    scene = BoundaryScene(**facts())
    scene.save(tmp_path / "scene.npz")
    was, again = scene.boundary, BoundaryScene.load(tmp_path / "scene.npz").boundary
    np.testing.assert_array_equal(again.points_cam, was.points_cam)
    np.testing.assert_array_equal(again.pixels, was.pixels)
    assert again.pixels.dtype == np.int64
    np.testing.assert_array_equal(again.tangents_cam[0], 0.0)
    cosine = np.sum(again.tangents_cam[1:] * was.tangents_cam[1:], axis=1)
    assert cosine.min() > np.cos(np.deg2rad(0.5))
    np.testing.assert_allclose(np.linalg.norm(again.tangents_cam[1:], axis=1), 1.0)
    np.testing.assert_allclose(again.linearity, was.linearity, atol=0.5 / 255 + 1e-12)


def test_an_empty_scene_has_a_file_too(tmp_path: Path) -> None:
    BoundaryScene(**empty()).save(tmp_path / "scene.npz")
    again = BoundaryScene.load(tmp_path / "scene.npz")
    assert len(again.boundary) == 0
    assert again.T_cam_parts.shape == (0, 4, 4)
    assert again.instance_ids.shape == (0,)


def test_the_same_scene_is_the_same_file(tmp_path: Path) -> None:
    BoundaryScene(**facts()).save(tmp_path / "a.npz")
    BoundaryScene(**facts()).save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_surface_out_of_the_files_reach_is_refused(tmp_path: Path) -> None:
    far = Surface(depth=np.full((2, 2), 1.4, np.float32), u0=0.0, v0=0.0, cell=2.0)
    scene = BoundaryScene(**facts() | {"surface": far})
    with pytest.raises(ValueError, match=r"a scene file holds depths up to 1\.31 m, the surface has 1\.40 m"):
        scene.save(tmp_path / "scene.npz")
    assert list(tmp_path.iterdir()) == []


# --- whole or absent -------------------------------------------------------------------------------------------------


def test_a_save_that_fails_leaves_the_old_file_and_no_draft(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scene.npz"
    BoundaryScene(**facts()).save(path)
    before = path.read_bytes()

    def full_disk(file: Any, **_: object) -> None:
        file.write(b"half of it")
        raise OSError("No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(OSError, match="No space left"):
        BoundaryScene(**facts(seed=1)).save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("kept", [0, 1, 30, 0.5, 0.9, -1])
def test_a_cut_off_file_is_an_error(tmp_path: Path, kept: float) -> None:
    path = tmp_path / "scene.npz"
    BoundaryScene(**facts()).save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole)) if isinstance(kept, float) else kept])
    with pytest.raises(SceneError, match=rf"{re.escape(str(path))} does not hold a complete scene \("):
        BoundaryScene.load(path)


@pytest.mark.slow
def test_a_flipped_bit_is_an_error_or_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    scene = BoundaryScene(**facts())
    scene.save(path)
    whole, rng, refused = path.read_bytes(), np.random.default_rng(0), 0
    for place in rng.integers(0, len(whole), 200):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 16]) + whole[place + 1 :])
        try:
            again = BoundaryScene.load(path)
        except SceneError:
            refused += 1
        else:
            np.testing.assert_array_equal(again.boundary.points_cam, scene.boundary.points_cam)
            np.testing.assert_array_equal(again.instance_ids, scene.instance_ids)
    assert refused > 150


def test_a_missing_or_foreign_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"nowhere\.npz does not hold a complete scene .*No such file"):
        BoundaryScene.load(tmp_path / "nowhere.npz")
    np.savez(tmp_path / "other.npz", points=np.zeros(3))
    with pytest.raises(
        SceneError, match=r"other\.npz does not hold a complete scene \('tangents' is missing\); generate_scenes"
    ):
        BoundaryScene.load(tmp_path / "other.npz")
    (tmp_path / "text.npz").write_text("solid part")
    with pytest.raises(SceneError, match=r"text\.npz does not hold a complete scene"):
        BoundaryScene.load(tmp_path / "text.npz")


def test_another_version_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scene.npz"
    with monkeypatch.context() as patched:
        patched.setattr(scene_module, "FORMAT", replace(scene_module.FORMAT, version=99))
        BoundaryScene(**facts()).save(path)
    with pytest.raises(SceneError, match=r"scene\.npz is a scene of version 99, this code reads 1; update binpick"):
        BoundaryScene.load(path)


# --- a part of a scene, and nonsense ---------------------------------------------------------------------------------


def test_only_keeps_the_points_of_a_mask() -> None:
    scene = BoundaryScene(**facts())
    mask = scene.instance_ids == 2
    some = scene.only(mask)
    assert 0 < len(some.boundary) == mask.sum() < 200
    assert (some.instance_ids == 2).all()
    for name in ("points_cam", "tangents_cam", "linearity", "pixels"):
        np.testing.assert_array_equal(getattr(some.boundary, name), getattr(scene.boundary, name)[mask])
    np.testing.assert_array_equal(some.T_cam_parts, scene.T_cam_parts)
    assert some.surface is scene.surface
    assert len(scene.boundary) == 200
    assert len(scene.only(np.zeros(200, bool)).boundary) == 0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"instance_ids": np.zeros(3, int)}, r"instance_ids must be \(200,\), got \(3,\)"),
        ({"T_cam_parts": np.zeros((PARTS, 3, 4))}, r"T_cam_parts must be \(4, 4, 4\), got \(4, 3, 4\)"),
        ({"centres_cam": np.zeros((3, 3))}, r"centres_cam must be \(4, 3\), got \(3, 3\)"),
        ({"visible_fractions": np.zeros(5)}, r"visible_fractions must be \(4,\), got \(5,\)"),
        ({"instance_ids": np.full(200, PARTS)}, "instance_ids go up to 4, but there are 4 parts"),
        ({"d_max": 0.0}, r"d_max must be positive, got 0\.0"),
        ({"d_max": np.nan}, "d_max must be positive, got nan"),
    ],
)
def test_nonsense_in_a_scene_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        BoundaryScene(**facts() | changes)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("K", np.full((3, 3), np.nan), "K must be finite"),
        ("K", np.zeros((3, 3)), "K must have positive focal lengths"),
        ("K", np.eye(4), r"K must be \(3, 3\)"),
        ("T_cam_parts", np.zeros((PARTS, 4, 4)), "T_cam_parts must be"),
        ("centres_cam", np.full((PARTS, 3), np.inf), "centres_cam must be finite"),
        ("visible_fractions", np.full(PARTS, 1.5), r"visible_fractions must be in \[0, 1\]"),
        ("linearity", np.zeros(200), "linearity is of type float64, which no scene has"),
        ("instance_ids", np.full(200, "0"), "instance_ids is of type <U1, which no scene has"),
        ("instance_ids", np.full(200, -2, np.int16), "instance_ids must be -1 or the number of a part, got -2"),
        ("part", np.array(3.0), "part is of type float64, which no scene has"),
    ],
)
def test_a_file_whose_values_have_no_meaning_is_refused(
    name: str, value: np.ndarray, text: str, tmp_path: Path
) -> None:
    path = tmp_path / "scene.npz"
    BoundaryScene(**facts()).save(path)
    with np.load(path) as stored:
        arrays = {key: stored[key] for key in stored.files}
    np.savez(path, **(arrays | {name: value}))
    with pytest.raises(SceneError, match=text):
        BoundaryScene.load(path)
