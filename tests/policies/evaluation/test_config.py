"""Settings of an evaluation: their digest, and the seeds that follow from them."""

import dataclasses
from pathlib import Path

import pytest
import trimesh

from binpick_env.config import CameraConfig, CellConfig
from binpick_env.observation.oracle import PoseNoise
from perception.segmentation import weights
from policies.evaluation.config import EvaluationConfig, bin_seed
from policies.evaluation.jobs import Job
from policies.picking.settings import PickerSettings

CONFIG = EvaluationConfig(num_parts=(6, 6))


def test_a_bins_seed_follows_from_seed_and_index_alone() -> None:
    assert bin_seed(0, 0) == 2968811710  # golden: a change of the rule would change every published number
    assert len({bin_seed(seed, index) for seed in range(20) for index in range(50)}) == 1000


def test_the_digest_sees_every_setting() -> None:
    changes = {
        "part": "part_a",
        "unit": "mm",
        "symmetry": "none",
        "density": 900.0,
        "seed": 1,
        "sensor": "none",
        "num_parts": (6, 7),
        "camera": CameraConfig(width=640, height=480),
        "bin": (0.3, 0.2, 0.1),
        "jaw": 0.06,
        "friction": 0.3,
        "symmetry_tolerance": 0.001,
        "hand_eye_deg": 1.0,
        "trust": "bin",
        "max_acceleration": 4.0,
        "max_jerk": 50.0,
        "network": "dgcnn-context",
    }
    digests = {dataclasses.replace(CONFIG, **{name: value}).digest() for name, value in changes.items()}
    assert len({*digests, CONFIG.digest()}) == len(changes) + 1
    assert EvaluationConfig(num_parts=(6, 6)).digest() == CONFIG.digest()


def test_the_digests_of_earlier_versions_are_kept() -> None:
    """Golden: folders of earlier runs cannot be resumed if a digest changes.

    The last change was meant: the next frame is taken with the load over the tray.
    """
    assert EvaluationConfig().digest() == "4a5f7a788d19b4d5"
    assert EvaluationConfig(picker=PickerSettings().attempts_only()).digest() != EvaluationConfig().digest()
    config = EvaluationConfig(
        part="part_b",
        unit="mm",
        symmetry="none",
        density=900.0,
        seed=7,
        perception="oracle",
        sensor="harsh",
        num_parts=(6, 8),
        camera=CameraConfig(width=640, height=480, hand_eye=0.01, backend="rays"),
        pose_noise=PoseNoise(translation=0.001, rotation=0.02),
        picker=PickerSettings(grasps_tried=10),
        bin=(0.3, 0.2, 0.1),
    )
    assert config.digest() == "e72a5ddbfc89420a"


def test_every_setting_of_the_cell_arrives_in_its_config() -> None:
    camera = CameraConfig(width=640, height=480, focal=2000.0, distance=0.8)
    limits = {"max_acceleration": 4.0, "max_jerk": 50.0}
    cell = EvaluationConfig(bin=(0.3, 0.2, 0.1), jaw=0.06, friction=0.3, camera=camera, **limits).cell()
    assert (cell.bin.inner_size, cell.robot.jaw, cell.contact.friction[0]) == ((0.3, 0.2, 0.1), 0.06, 0.3)
    assert (cell.robot.max_acceleration, cell.robot.max_jerk) == (4.0, 50.0)
    assert cell.camera == camera
    assert EvaluationConfig().cell() == CellConfig()


def test_the_digest_sees_the_part_files_contents(tmp_path: Path) -> None:
    path = tmp_path / "part.stl"
    config = EvaluationConfig(part=str(path))
    path.write_bytes(b"one")
    one = config.digest()
    path.write_bytes(b"two")
    assert config.digest() != one


@pytest.mark.usefixtures("coarse_grasps")
def test_impossible_settings_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="seed must not be negative, got -1"):
        EvaluationConfig(seed=-1)
    with pytest.raises(ValueError, match=r"num_parts must be a rising pair from 1, got \(5, 4\)"):
        EvaluationConfig(num_parts=(5, 4))
    with pytest.raises(ValueError, match=r"bin must be .* all positive, got \(0.3, 0.0, 0.1\)"):
        EvaluationConfig(bin=(0.3, 0.0, 0.1))
    with pytest.raises(ValueError, match=r"jaw must be over 0 and at most 0.085 m, the 2F-85's stroke, got 0.1"):
        EvaluationConfig(jaw=0.1)
    with pytest.raises(ValueError, match=r"friction must be from 0 to 2, got 3.0"):
        EvaluationConfig(friction=3.0)
    with pytest.raises(ValueError, match="bins and workers must be at least 1, got 0 and 1"):
        Job(out=tmp_path, bins=0)
    with pytest.raises(ValueError, match=r"part must be one of .*tee.*, got 'teapot'"):
        EvaluationConfig(part="teapot").check()
    trimesh.creation.box((0.06, 0.04, 0.03)).export(tmp_path / "block.stl")
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))  # a user's own weights would be there
    with monkeypatch.context() as changed:
        changed.setattr(weights, "SHIPPED", tmp_path)
        with pytest.raises(ValueError, match="'learned' cannot recognise 'block': there are no segmentation"):
            EvaluationConfig(part=str(tmp_path / "block.stl")).check()
    learned = EvaluationConfig(part=str(tmp_path / "block.stl")).weights()
    assert learned is not None
    assert learned["training"] == "zero-shot"
    assert EvaluationConfig(part=str(tmp_path / "gone.stl")).weights() is None  # its records are still summarised
    assert EvaluationConfig(part=str(tmp_path / "block.stl"), perception="oracle").check().model.name == "block"


@pytest.mark.slow
@pytest.mark.parametrize("side", [0.08, 0.079])
def test_a_part_that_the_jaw_cannot_hold_is_refused_before_perception_is_prepared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, side: float
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("policies.evaluation.config.make_perceiver", None)
    trimesh.creation.box((side, side + 0.001, side + 0.002)).export(tmp_path / "cube.stl")
    evaluation = EvaluationConfig(part=str(tmp_path / "cube.stl"), num_parts=(2, 3))
    text = (
        rf"finds no grasp on 'cube': it takes at most 7\d mm between two opposite faces, .* {1000 * side:.0f} mm apart"
    )
    with pytest.raises(ValueError, match=text):
        evaluation.check()


def test_more_parts_than_can_be_heaped_on_the_bin_are_refused() -> None:
    with pytest.raises(ValueError, match=r"200 parts of d_max 92 mm do not fit into a bin of 360 x 260 x 120 mm"):
        EvaluationConfig(num_parts=(20, 200), perception="oracle").check()
