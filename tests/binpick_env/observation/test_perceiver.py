"""The oracle: which parts it offers, in which order, and how large its errors are; and how a perceiver is chosen."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from binpick_env.config import BinConfig
from binpick_env.observation.candidate_from_pose import make_candidate
from binpick_env.observation.factory import make_perceiver
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.oracle import OFFERED_FROM, OraclePerceiver, PoseNoise
from perception.geometry import Floats, make_transform, random_rotation, rotation_angle, transform_points
from perception.part import PartModel
from perception.segmentation import weights
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.weights import WeightsError

WORKSPACE = BinConfig().workspace()


def off_centre() -> PartModel:
    """Return a block whose frame is far from its centre."""
    box = trimesh.creation.box((0.06, 0.04, 0.02))
    box.apply_translation((0.05, -0.02, 0.03))
    return PartModel.from_mesh("block", box)


def view(fractions: list[float], part: PartModel | None = None, seed: int = 0) -> LabelledCapture:
    rng = np.random.default_rng(seed)
    poses = [
        WORKSPACE.T_world_bin @ make_transform(random_rotation(rng), rng.uniform(-0.05, 0.05, 3)) for _ in fractions
    ]
    true: Any = SimpleNamespace(T_world_cam=np.eye(4))
    capture: Any = SimpleNamespace(frame=true, T_world_cam=true.T_world_cam)  # the oracle reads no image
    return LabelledCapture(
        capture=capture,
        workspace=WORKSPACE,
        part=part or off_centre(),
        T_world_parts=np.array(poses).reshape(-1, 4, 4),
        visible_fractions=np.array(fractions),
    )


def perceive(seen: LabelledCapture, noise: PoseNoise | None = None, seed: int = 0) -> list[Any]:
    observed = OraclePerceiver(noise).perceive(seen, np.random.default_rng(seed))
    assert observed.perception is None  # it reads the truth
    return observed.candidates


def test_parts_are_offered_from_the_threshold_the_most_visible_first() -> None:
    candidates = perceive(view([0.29, 0.95, 0.3, 1.0, 0.0, 0.95]))
    assert OFFERED_FROM == 0.3
    assert [c.part for c in candidates] == [3, 1, 5, 2]
    assert [c.visible_fraction for c in candidates] == [1.0, 0.95, 0.95, 0.3]
    assert [c.fill for c in candidates] == [c.visible_fraction for c in candidates]
    assert {c.score for c in candidates} == {1.0}


def test_another_threshold_can_be_set() -> None:
    seen = view([0.29, 0.05, 0.7])
    observed = OraclePerceiver(offered_from=0.05).perceive(seen, np.random.default_rng(0))
    assert [c.part for c in observed.candidates] == [2, 0, 1]


@pytest.mark.parametrize("fractions", [[], [0.0, 0.1]])
def test_nothing_visible_is_an_empty_list(fractions: list[float]) -> None:
    assert perceive(view(fractions)) == []


def test_without_noise_poses_are_true_and_chance_is_left_alone() -> None:
    seen = view([1.0, 0.5])
    rng = np.random.default_rng(3)
    candidates = OraclePerceiver().perceive(seen, rng).candidates
    for candidate in candidates:
        np.testing.assert_array_equal(candidate.T_world_part, seen.T_world_parts[candidate.part])
    assert rng.random() == np.random.default_rng(3).random()


def test_a_candidate_is_completed_by_hand() -> None:
    seen = view([1.0])
    pose = WORKSPACE.T_world_bin @ make_transform(translation=(0.0, 0.0, 0.01))
    candidate = make_candidate(seen, pose, score=0.4, visible_fraction=0.5, fill=0.6)
    np.testing.assert_allclose(WORKSPACE.to_bin(candidate.centre_world[None])[0], (0.05, -0.02, 0.04), atol=1e-12)
    assert candidate.top == pytest.approx(0.01 + 0.03 + 0.01)
    assert (candidate.score, candidate.visible_fraction, candidate.fill, candidate.part) == (0.4, 0.5, 0.6, -1)


def errors(noise: PoseNoise, count: int = 3000) -> tuple[Floats, Floats]:
    """Return the errors (N, 3) of the centres [m] and (N,) of the rotations [rad] over many captures."""
    part = off_centre()
    seen = view([1.0] * count, part)
    candidates = perceive(seen, noise)
    truth = seen.T_world_parts[[c.part for c in candidates]]
    poses = np.stack([c.T_world_part for c in candidates])
    true_centres = np.stack([transform_points(T, part.centre[None])[0] for T in truth])
    turns = rotation_angle(poses[:, :3, :3] @ np.swapaxes(truth[:, :3, :3], 1, 2))
    return np.stack([c.centre_world for c in candidates]) - true_centres, turns


def test_translation_noise_has_the_stated_size() -> None:
    shifts, turns = errors(PoseNoise(translation=0.002))
    np.testing.assert_allclose(shifts.std(axis=0), 0.002, rtol=0.06)
    np.testing.assert_allclose(shifts.mean(axis=0), 0.0, atol=0.002 * 4 / np.sqrt(3000))
    np.testing.assert_allclose(turns, 0.0, atol=1e-7)


def test_rotation_noise_has_the_stated_size_and_moves_no_centre() -> None:
    shifts, turns = errors(PoseNoise(rotation=0.05))
    assert np.sqrt(np.mean(turns**2)) == pytest.approx(0.05, rel=0.06)
    assert np.median(turns) == pytest.approx(0.05 * 0.6745, rel=0.06)  # of a half-normal: the angle itself is Gaussian
    np.testing.assert_allclose(shifts, 0.0, atol=1e-12)


def test_a_noisy_candidate_is_of_one_piece() -> None:
    part = off_centre()
    for candidate in perceive(view([1.0] * 5, part), PoseNoise(translation=0.003, rotation=0.1)):
        T = candidate.T_world_part
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_array_equal(T[3], (0, 0, 0, 1))
        np.testing.assert_allclose(candidate.centre_world, transform_points(T, part.centre[None])[0], atol=1e-12)
        heights = WORKSPACE.to_bin(transform_points(T, np.asarray(part.mesh.vertices)))[:, 2]
        assert candidate.top == pytest.approx(heights.max())


def test_noise_is_seeded_and_the_truth_is_not_touched() -> None:
    seen = view([1.0, 0.6])
    before = seen.T_world_parts.copy(), seen.visible_fractions.copy()
    noise = PoseNoise(translation=0.01, rotation=0.1)
    first, again, other = (np.stack([c.T_world_part for c in perceive(seen, noise, seed=seed)]) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-4
    np.testing.assert_array_equal(seen.T_world_parts, before[0])
    np.testing.assert_array_equal(seen.visible_fractions, before[1])
    assert not np.shares_memory(first, seen.T_world_parts)


def test_a_candidate_may_be_changed_without_changing_the_truth() -> None:
    seen = view([1.0])
    before = seen.T_world_parts.copy()
    (candidate,) = perceive(seen)
    candidate.T_world_part[:] = 0.0
    np.testing.assert_array_equal(seen.T_world_parts, before)


# --- choosing a perceiver


def test_the_oracle_is_built_with_its_noise() -> None:
    seen = view([1.0])
    perceiver = make_perceiver("oracle", seen.part, WORKSPACE, PoseNoise(translation=0.01))
    (candidate,) = perceiver.perceive(seen, np.random.default_rng(0)).candidates
    assert np.linalg.norm(candidate.T_world_part - seen.T_world_parts[0]) > 1e-3


@pytest.mark.parametrize("noise", [{"translation": -0.001}, {"rotation": -0.1}])
def test_negative_noise_is_refused(noise: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"noise must not be negative, got -?0\.0\d* m and -?0\.\d+ rad"):
        PoseNoise(**noise)
    with pytest.raises(ValueError, match="must be finite, got nan"):
        PoseNoise(**dict.fromkeys(noise, np.nan))


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="perception must be one of oracle, gt_masks, learned, got 'lidar'"):
        make_perceiver("lidar", off_centre(), WORKSPACE)
    with pytest.raises(ValueError, match="network must be one of grid, dgcnn-sgpn, dgcnn-context, got 'unet'"):
        make_perceiver("learned", off_centre(), WORKSPACE, network="unet")


@pytest.mark.parametrize("mode", ["gt_masks", "learned"])
def test_an_open_mesh_is_refused_where_poses_are_estimated(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SegmentationPredictor, "for_part", lambda part, network: None)
    whole = off_centre()
    half = PartModel(
        name="half",
        mesh=trimesh.Trimesh(whole.mesh.vertices, whole.mesh.faces[:-2], process=False),
        d_max=whole.d_max,
        symmetry=whole.symmetry,
        centre=whole.centre,
    )
    with pytest.raises(ValueError, match="the mesh of 'half' must enclose a volume"):
        make_perceiver(mode, half, WORKSPACE)


def test_a_part_without_weights_is_told_how_to_train_them_and_what_else_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path))  # where a user's own would lie
    monkeypatch.setattr(weights, "SHIPPED", tmp_path / "shipped")  # its networks for several parts serve for any
    with pytest.raises(WeightsError) as raised:
        make_perceiver("learned", off_centre(), WORKSPACE)
    text = str(raised.value)
    for told in (
        "perception='learned' cannot recognise 'block'",
        "make scenes with binpick generate-scenes",
        "train with binpick train-segmentation",
        "perception='gt_masks' (true segments) and 'oracle' (true poses)",
    ):
        assert told in text
