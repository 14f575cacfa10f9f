"""Text of any encoding that its first bytes tell is read, by every reader of text."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from perception.capture import read_calibration
from perception.capture.content import load_content
from perception.capture.text_files import as_utf8, floats_of, read_text

XYZ = "0.1 0.2 0.9\n0.3 0.2 0.8\n"
PLY = f"ply\nformat ascii 1.0\nelement vertex 2\n{''.join(f'property float {a}' + chr(10) for a in 'xyz')}end_header\n"
PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nDATA ascii\n"
CAMERA = {"fx": 600, "fy": 610, "cx": 320, "cy": 240}
YAML = "".join(f"{key}: {value}\n" for key, value in CAMERA.items())
CALIBRATED: Callable[[Path], np.ndarray] = lambda path: read_calibration(path).K  # noqa: E731
POINTS: Callable[[Path], np.ndarray] = lambda path: load_content(path).cloud.points  # type: ignore[union-attr]  # noqa: E731


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32"])
@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("camera.json", json.dumps(CAMERA), CALIBRATED),
        ("camera.yaml", YAML, CALIBRATED),
        ("cloud.ply", PLY + XYZ, POINTS),
        ("cloud.pcd", PCD + XYZ, POINTS),
    ],
)
def test_encodings_with_a_mark_are_read(
    tmp_path: Path, encoding: str, name: str, text: str, read: Callable[[Path], np.ndarray]
) -> None:
    (tmp_path / name).write_text(text, encoding=encoding)
    there = [[600, 0, 320], [0, 610, 240], [0, 0, 1]] if read is CALIBRATED else [[[0.1, 0.2, 0.9], [0.3, 0.2, 0.8]]]
    np.testing.assert_allclose(read(tmp_path / name), there, rtol=1e-6)


def test_a_calibration_in_utf_16_without_a_mark_is_named(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(CAMERA), encoding="utf-16-be")
    with pytest.raises(ValueError, match=r"^camera\.json must be a calibration in JSON or YAML, got UTF-16 without a"):
        read_calibration(path)


def test_accents_of_another_encoding_are_no_error(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes("# Teil f\u00fcr\n1".encode("latin-1"))
    assert read_text(tmp_path / "a.txt") == "# Teil f\ufffdr\n1"


def test_a_mark_of_another_encoding_is_refused() -> None:
    with pytest.raises(ValueError, match=r"a.txt must be text in UTF-16-LE, as its first bytes say, got .* at byte 2"):
        as_utf8(b"\xff\xfea\0b", "a.txt")


@pytest.mark.parametrize(("name", "header"), [("cloud.ply", PLY), ("cloud.pcd", PCD)])
def test_decimal_commas_of_a_cloud_are_named(tmp_path: Path, name: str, header: str) -> None:
    (tmp_path / name).write_text(header + XYZ.replace(".", ","))
    with pytest.raises(ValueError, match=f"^{name} must hold numbers, got '0,1': write decimal points in place"):
        load_content(tmp_path / name)


def test_words_that_are_numbers_are_read() -> None:
    np.testing.assert_array_equal(floats_of([b"1", b"nan", b"-2e-3"], "a"), [1.0, np.nan, -0.002])
    with pytest.raises(ValueError, match=r"^a must hold numbers, got 'one'$"):
        floats_of(["1", "one"], "a")
