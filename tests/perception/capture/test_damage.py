"""Damaged files of every format are refused by name, whatever their decoder raises."""

import ast
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import perception.capture
from perception.capture import read_calibration, read_frame
from perception.capture.content import load_content
from perception.capture.damage import decoding
from tests.perception.capture.camera_files import HEIGHT, WIDTH, K, pcd_header, scene_depth, scene_points, written

XYZ = ("x y z", "4 4 4", "F F F")
PLY = f"ply\nformat ascii 1.0\nelement vertex {WIDTH * HEIGHT}\n" + "".join(f"property float {a}\n" for a in "xyz")


def contents(tmp_path: Path) -> dict[str, bytes]:
    points = scene_points("<f4")
    text = "\n".join(" ".join(f"{value:.9g}" for value in point) for point in points.reshape(-1, 3)).encode()
    np.savez(tmp_path / "whole.npz", depth=scene_depth(), K=K)
    np.save(tmp_path / "whole.npy", scene_depth())
    cv2.imwrite(str(tmp_path / "whole.png"), np.rint(scene_depth() * 1000).astype(np.uint16))
    flat = {"fx": 20.0, "fy": 21.0, "ppx": 3.4, "ppy": 2.7, "width": 8, "height": 6}
    return {
        "text.pcd": pcd_header(*XYZ, "ascii") + text,
        "bytes.pcd": pcd_header(*XYZ, "binary") + points.tobytes(),
        "text.ply": PLY.encode() + b"end_header\n" + text,
        **{f"a.{kind}": (tmp_path / f"whole.{kind}").read_bytes() for kind in ("npz", "npy", "png")},
        "camera.json": json.dumps(flat).encode(),
        "camera.yaml": "".join(f"{key}: {value}\n" for key, value in flat.items()).encode(),
    }


def refusal(path: Path) -> str:
    """Return the text of the error that reading a file raises, empty if it raises none."""
    try:
        read_calibration(path) if path.stem == "camera" else load_content(path)
    except ValueError as error:
        return str(error)
    return ""


def test_damage_is_refused_by_name_or_harmless(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    refused = dict.fromkeys(contents(tmp_path), 0)
    for name, whole in contents(tmp_path).items():
        for trial in range(30):
            damaged = bytearray(whole)
            if trial % 2:
                damaged = damaged[: rng.integers(0, len(whole))]
            else:
                damaged[rng.integers(0, min(len(whole), 250))] = rng.integers(0, 256)
            path = written(tmp_path / name, bytes(damaged))
            refused[name] += name in refusal(path)
    assert min(refused.values()) >= 10


def test_what_must_be_is_said_with_the_name_of_the_file(tmp_path: Path) -> None:
    skewed = written(tmp_path / "camera.json", json.dumps({"K": [[20, 0.5, 3], [0, 20, 2], [0, 0, 1]]}))
    with pytest.raises(ValueError, match=r"^camera\.json: K must have no skew, got K\[0, 1\] = 0\.5 px"):
        read_calibration(skewed)


def test_what_the_system_says_is_passed_on(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_content(tmp_path / "none.npz")
    with (
        pytest.raises(ValueError, match=r"a\.xyz must be a complete file of the format that \.xyz says, .*KeyError: 1"),
        decoding(Path("a.xyz")),
    ):
        raise KeyError(1)
    with pytest.raises(ValueError, match=r"^a\.xyz is bad$"), decoding(Path("a.xyz")):
        raise ValueError("a.xyz is bad")


DECODERS = (
    *("azure", "calibration_files", "content", "images", "pcd", "ply", "ply_header", "recordings", "ros_messages"),
    "text_files",
)


@pytest.mark.parametrize("module", DECODERS)
def test_refusals_of_decoders_say_what_must_be_and_so_are_not_reported_as_damage(module: str) -> None:
    source = (Path(perception.capture.__file__).parent / f"{module}.py").read_text(encoding="utf-8")
    raised = [each.exc for each in ast.walk(ast.parse(source)) if isinstance(each, ast.Raise) and each.exc]
    texts = [ast.unparse(each) for each in raised]
    refusals = [text for text in texts if text.startswith("ValueError")]
    assert refusals
    # A text that continues another error's has the other one's "must".
    assert [text for text in refusals if " must " not in text and "{refusal}; " not in text] == []


def test_an_error_of_the_system_that_a_decoder_runs_into_names_the_file(tmp_path: Path) -> None:
    """A decoder of damaged bytes may ask for an impossible place in the file."""
    with (
        pytest.raises(ValueError, match=r"scan.npz must be a complete file .* Invalid argument"),
        decoding(tmp_path / "scan.npz"),
    ):
        raise OSError(22, "Invalid argument")
    with pytest.raises(FileNotFoundError), decoding(tmp_path / "scan.npz"):
        (tmp_path / "scan.npz").read_bytes()


@pytest.mark.parametrize("name", ["cell", "cell.png"])
def test_a_folder_or_a_link_to_nothing_is_no_frame(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / "link.png").symlink_to("gone.png")
    (tmp_path / "K.json").write_text('{"K": [[9, 0, 1], [0, 9, 1], [0, 0, 1]]}')
    np.save(tmp_path / "a.npy", np.ones((4, 4), np.float32))
    with pytest.raises(
        IsADirectoryError, match=r"a frame must be a file, or the folder of a ROS 2 bag .* got the folde"
    ):
        read_frame(tmp_path / name)
    with pytest.raises(
        FileNotFoundError, match=r"a frame must be a file, got .*link\.png, a link to gone\.png, which is"
    ):
        read_frame(tmp_path / "link.png")
    with pytest.raises(FileNotFoundError, match=r"there is no frame .*lost\.png"):
        read_frame(tmp_path / "lost.png")
    with pytest.raises(
        IsADirectoryError, match=r"a calibration must be a file, got the folder .*: name the files in it$"
    ):
        read_frame(tmp_path / "a.npy", calibration=tmp_path / name)
    with pytest.raises(IsADirectoryError, match="a grey image must be a file, got the folder"):
        read_frame(tmp_path / "a.npy", grey=tmp_path / name, calibration=tmp_path / "K.json")
