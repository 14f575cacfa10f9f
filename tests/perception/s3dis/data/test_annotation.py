"""Reading the text of an object: against plain Python, and every way that a line can be wrong."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.s3dis.data.annotation import KNOWN_FAULTS, RawDataError, read_annotation
from tests.perception.s3dis.s3dis_tree import LINES

TWIN = runpy.run_path(str(Path(__file__).parents[3] / "reference" / "s3dis_twin.py"))


def read(folder: Path, text: str, name: str = "Area_1/office_1/Annotations/chair_1.txt"):  # type: ignore[no-untyped-def]
    path = folder / "chair_1.txt"
    path.write_bytes(text.encode("latin-1"))
    return read_annotation(path, name)


def test_two_lines_by_hand(tmp_path: Path) -> None:
    found = read(tmp_path, LINES)
    np.testing.assert_array_equal(found.xyz, np.array([[1.5, -2.25, 0.125], [1, 2, 3]], np.float32))
    np.testing.assert_array_equal(found.rgb, np.array([[10, 20, 30], [255, 0, 128]], np.uint8))
    assert (found.xyz.dtype, found.rgb.dtype, found.remark) == (np.float32, np.uint8, "")


@pytest.mark.parametrize(
    "text",
    [
        LINES.removesuffix("\n"),
        LINES.replace("\n", "\r\n"),
        LINES.replace(" ", "\t"),
        "\n" + LINES + "\n \n",
        LINES.replace("10 20 30", "10.000000 20.0 30."),
        LINES.replace("1.500", "+1.5e0").replace("-2.250", "-225E-2").replace("0.125", ".125"),
    ],
    ids=["no last newline", "windows", "tabs", "blank lines", "colours as floats", "exponents"],
)
def test_other_ways_to_write_the_same(tmp_path: Path, text: str) -> None:
    found, plain = read(tmp_path, text), read(tmp_path, LINES)
    np.testing.assert_array_equal(found.xyz, plain.xyz)
    np.testing.assert_array_equal(found.rgb, plain.rgb)


NUMBERS = st.one_of(
    st.floats(-1e5, 1e5).map(lambda value: f"{value:.6f}"),
    st.floats(-1e5, 1e5).map(repr),
    st.floats(-1e5, 1e5).map(lambda value: f"{value:.18f}"),
    st.integers(-(10**5), 10**5).map(str),
)
COLOURS = st.integers(0, 255).map(str)


@settings(max_examples=200, deadline=None)
@given(rows=st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS, COLOURS, COLOURS, COLOURS), min_size=1, max_size=5))
def test_numbers_are_those_of_python(tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[str, ...]]) -> None:
    text = "\n".join(" ".join(row) for row in rows)
    found = read(tmp_path_factory.mktemp("text"), text)
    expected = np.array(TWIN["read_points"](text))
    np.testing.assert_allclose(found.xyz, expected[:, :3].astype(np.float32), rtol=1.2e-7, atol=0)
    np.testing.assert_array_equal(found.rgb, expected[:, 3:])


@settings(max_examples=200, deadline=None)
@given(text=st.text(alphabet="0159 .-e\n\x00x", max_size=60))
def test_what_python_cannot_read_is_an_error_at_the_same_line(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    good = "1 2 3 4 5 6\n"
    expected = TWIN["read_points"](good + text)
    folder = tmp_path_factory.mktemp("text")
    if isinstance(expected, int):
        with pytest.raises(RawDataError, match=rf"chair_1\.txt, line {expected} holds"):
            read(folder, good + text)
    elif all(abs(value) <= 1e6 for row in expected for value in row):
        assert len(read(folder, good + text).xyz) == len(expected)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 2 3 4 5", "line 3 holds not 6 numbers: '1 2 3 4 5'"),
        ("1 2 3 4 5 6 7", "line 3 holds not 6 numbers"),
        ("1 2 x 4 5 6", "line 3 holds text that is not a number"),
        ("1 2 nan 4 5 6", "line 3 holds text that is not a number"),
        ("1 2 3. 4 5 6-", "line 3 holds text that is not a number"),
        ("1 2 1e 4 5 6", "line 3 holds text that is not a number"),
        ("1 2 - 4 5 6", "line 3 holds text that is not a number"),
        ("1 2 1.2.3 4 5 6", "line 3 holds text that is not a number"),
        ("1 2 3 4 5 256", "line 3 holds a colour that is not a whole number from 0 to 255"),
        ("1 2 3 4 -5 6", "line 3 holds a colour that is not a whole number from 0 to 255"),
        ("1 2 3 4 5.5 6", "line 3 holds a colour that is not a whole number from 0 to 255"),
        ("1 2 2e6 4 5 6", "line 3 holds a coordinate beyond 1000000 m"),
        ("1 2 1e999 4 5 6", "line 3 holds a coordinate beyond 1000000 m"),
        ("1 2 3 185\x00187 6", r"line 3 holds text that is not a number: '1 2 3 185\\x00187 6'"),
    ],
)
@pytest.mark.parametrize("ending", ["", "\n", "\n1 2 3 4 5 6\n"])
def test_a_malformed_line_is_named(tmp_path: Path, line: str, message: str, ending: str) -> None:
    with pytest.raises(RawDataError, match=f"chair_1.txt, {message}"):
        read(tmp_path, LINES + line + ending)


@pytest.mark.parametrize("text", ["", "\n\n"])
def test_a_file_without_points_is_an_error(tmp_path: Path, text: str) -> None:
    with pytest.raises(RawDataError, match=r"chair_1\.txt, line 1 is missing: there are no points"):
        read(tmp_path, text)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damaged", "repaired"),
    [
        ("22.350 6.692 3.048 185\x00187 182", "22.350 6.692 3.048 185 187 182"),
        ("22.350 6.692 3.048 185\x10187 182", "22.350 6.692 3.048 185 187 182"),
        ("1.0 2.0 3.0 103.0\x100000 100.0 99.0", "1.0 2.0 3.0 103.000000 100.0 99.0"),
    ],
)
@pytest.mark.parametrize("name", KNOWN_FAULTS)
def test_the_known_faults_are_repaired_and_reported(tmp_path: Path, damaged: str, repaired: str, name: str) -> None:
    found, plain = read(tmp_path, LINES + damaged + "\n" + LINES, name), read(tmp_path, LINES + repaired + "\n" + LINES)
    np.testing.assert_array_equal(found.xyz, plain.xyz)
    np.testing.assert_array_equal(found.rgb, plain.rgb)
    assert found.remark == f"{name}, line 3: repaired a damaged byte"


def test_another_fault_in_a_file_with_a_known_one_is_still_an_error(tmp_path: Path) -> None:
    with pytest.raises(RawDataError, match="line 3 holds a colour"):
        read(tmp_path, LINES + "22.350 6.692 3.048 185187 182\n", KNOWN_FAULTS[0])
    with pytest.raises(RawDataError, match="line 3 holds text that is not a number"):
        read(tmp_path, LINES + "1 2 3 185\x00187 182\n1 2\n", KNOWN_FAULTS[0])


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_annotation(tmp_path / "nowhere.txt", "nowhere.txt")
