"""Files of points: what is read of them, what is written, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from perception.instance import Instance
from perception.segmentation.point_files import LabelledPoints, read_points, write_labels

POINTS = np.array([[0.1, 0.2, 0.9], [0.3, 0.2, 0.8], [0.1, -0.2, 0.7], [0.0, 0.5, 0.6]])


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize("between", [" ", "\t", ",", ", ", ";"])
def test_lines_of_three_four_or_five_numbers(tmp_path: Path, between: str) -> None:
    rows = [[*point, 0.5, label] for point, label in zip(POINTS.tolist(), (2, -3, 0, 2), strict=True)]
    for columns, labelled in (((0, 1, 2), False), ((0, 1, 2, 4), True), ((0, 1, 2, 3, 4), True)):
        lines = [between.join(str(row[c]) for c in columns) for row in rows]
        found = read_points(written(tmp_path / "cloud.txt", "\n".join(["x,y,z", "# a comment", "", *lines])))
        np.testing.assert_array_equal(found.points, POINTS)
        assert (None if found.labels is None else found.labels.tolist()) == ([2, -1, 0, 2] if labelled else None)


def test_colours_and_normals_are_left_out(tmp_path: Path) -> None:
    lines = [" ".join(map(str, [*point, 255, 0, 0])) for point in POINTS]
    found = read_points(written(tmp_path / "cloud.XYZ", "\n".join(lines)))
    np.testing.assert_array_equal(found.points, POINTS)
    assert found.labels is None


def test_the_first_line_of_a_pts_file_is_the_number_of_points(tmp_path: Path) -> None:
    lines = [" ".join(map(str, [*point, -1200, 90, 90, 90])) for point in POINTS]
    found = read_points(written(tmp_path / "cloud.pts", "\n".join(["4", *lines])))
    np.testing.assert_array_equal(found.points, POINTS)


def test_behind_a_number_of_points_the_fourth_number_is_an_intensity(tmp_path: Path) -> None:
    lines = [" ".join(map(str, [*point, intensity])) for point, intensity in zip(POINTS, (-3, 0, 7, 7), strict=True)]
    found = read_points(written(tmp_path / "scan.pts", "\n".join(["4", *lines])))
    np.testing.assert_array_equal(found.points, POINTS)
    assert found.labels is None
    labelled = read_points(written(tmp_path / "labelled.pts", "\n".join(lines)))
    assert labelled.labels is not None
    assert labelled.labels.tolist() == [-1, 0, 7, 7]


@pytest.mark.parametrize("between", [";", "; ", "\t", " "])
def test_commas_within_numbers_are_decimal_points(tmp_path: Path, between: str) -> None:
    rows = [[*point, label] for point, label in zip(POINTS.tolist(), (2, -3, 0, 2), strict=True)]
    lines = [between.join(str(value).replace(".", ",") for value in row) for row in rows]
    found = read_points(written(tmp_path / "cloud.csv", "\n".join(["x;y;z;label", *lines])))
    np.testing.assert_array_equal(found.points, POINTS)
    assert found.labels is not None
    assert found.labels.tolist() == [2, -1, 0, 2]
    tiny = read_points(written(tmp_path / "tiny.csv", "1,5e-3;-2E1;nan\n" + "1;2;3\n" * 3))
    np.testing.assert_array_equal(tiny.points[1:], [[1.0, 2.0, 3.0]] * 3)
    assert read_points(written(tmp_path / "e.csv", "1,5e-3;-2E1;3\n" * 3)).points[0].tolist() == [0.0015, -20.0, 3.0]


@pytest.mark.parametrize("line", ["1,2,3", "1, 2, 3", "1 , 2 ,3", "1,2,3;", "1;2;3", "1,\t2,\t3 "])
def test_commas_between_numbers_separate(tmp_path: Path, line: str) -> None:
    found = read_points(written(tmp_path / "cloud.csv", f"{line}\n" * 3))
    np.testing.assert_array_equal(found.points, [[1.0, 2.0, 3.0]] * 3)


@pytest.mark.parametrize("line", ["0.1,0.2,0.3 4", "0.1,0.2,0.3;4", "0.1,0.2,0.3\t4", "0.1, 0.2, 0.3 ;4"])
def test_a_label_may_stand_behind_another_separator(tmp_path: Path, line: str) -> None:
    found = read_points(written(tmp_path / "cloud.csv", f"{line}\n" * 3))
    np.testing.assert_array_equal(found.points, [[0.1, 0.2, 0.3]] * 3)
    assert found.labels is not None
    assert found.labels.tolist() == [4] * 3


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32", "utf-8-sig"])
def test_text_of_windows_is_read_by_its_byte_order_mark(tmp_path: Path, encoding: str) -> None:
    text = "\n".join(" ".join(map(str, point)) for point in POINTS)
    (tmp_path / "cloud.txt").write_text(text, encoding=encoding)
    if encoding == "utf-16-le":
        with pytest.raises(ValueError, match="must be text in UTF-8, got UTF-16 without a byte order mark: save it"):
            read_points(tmp_path / "cloud.txt")
    else:
        np.testing.assert_array_equal(read_points(tmp_path / "cloud.txt").points, POINTS)


def test_a_byte_order_mark_costs_no_point(tmp_path: Path) -> None:
    (tmp_path / "cloud.csv").write_text("\n".join(",".join(map(str, p)) for p in POINTS), encoding="utf-8-sig")
    np.testing.assert_array_equal(read_points(tmp_path / "cloud.csv").points, POINTS)


def test_a_ply_file_and_a_pcd_file(tmp_path: Path) -> None:
    body = "\n".join(" ".join(map(str, point)) for point in POINTS)
    ply = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    pcd = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\nPOINTS 4\nDATA ascii\n"
    for name, header in (("cloud.ply", ply), ("cloud.pcd", pcd)):
        found = read_points(written(tmp_path / name, header + body + "\n"))
        np.testing.assert_allclose(found.points, POINTS, atol=1e-7)


def test_labels_that_are_written_are_read(tmp_path: Path) -> None:
    points = np.vstack([POINTS, np.full((1, 3), np.nan)])
    instances = [Instance(point_idx=np.array([0, 2]), score=0.75), Instance(point_idx=np.array([1]), score=0.5)]
    write_labels(tmp_path / "labels.txt", points, instances)
    found = read_points(tmp_path / "labels.txt")
    np.testing.assert_array_equal(found.points, points)
    assert found.labels is not None
    assert found.labels.tolist() == [0, 1, 0, -1, -1]
    assert found.measured.tolist() == [True, True, True, True, False]


def test_the_truth_counts_every_labelled_part() -> None:
    labels = np.array([7, 7, -1, 3])
    truth = LabelledPoints(points=POINTS, labels=labels).truth()
    assert truth is not None
    assert truth.instance_ids.tolist() == [1, 1, -1, 0]
    assert not truth.ignored.any()
    assert LabelledPoints(points=POINTS).truth() is None


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("cloud.obj", "", r"cloud.obj must be a .ply, .pcd or text file \(.xyz, .*\), got .obj"),
        ("cloud.xyz", "1 2 3\n1 2 4\n", "must hold at least 3 measured points, got 2 of 2"),
        ("cloud.xyz", "", "must hold at least 3 measured points, got 0 of 0"),
        ("cloud.xyz", "1 2 3\n1 2 3\n0 0 0\nnan 1 1\n", "must hold at least 3 measured points, got 2 of 4"),
        ("cloud.xyz", "1 2 3\n1 2 three\n", "line 2 of cloud.xyz must be numbers, got '1 2 three'"),
        ("cloud.xyz", "1 2 3\n1 2\n", "line 2 of cloud.xyz must hold 3 numbers as the lines before, got 2"),
        ("cloud.xyz", "1\n1\n1\n", "lines of cloud.xyz must be x y z, x y z label .* got 1 numbers"),
        ("cloud.pts", "4\n" + "1 2 3\n" * 3, "cloud.pts must hold 4 points, as its first line says, got 3"),
        ("cloud.xyz", "1 2\n1 3\n", "lines of cloud.xyz must be x y z, x y z label .* got 2 numbers"),
        (
            "two.pts",
            ("4\n" + "1 2 3\n" * 4) * 2,
            "two.pts must hold one scan, got a second one of 4 points from line 6 on, behind the 4 points of the",
        ),
        ("cloud.pts", "4\n1 2 3\n4\n1 2 3\n", "line 3 of cloud.pts must hold 3 numbers as the lines before, got 1"),
        ("cloud.csv", "0.1,2;0.3,4;5,6\n" * 3, "line 1 .* must be numbers .*decimal points or separators, not both"),
        ("cloud.csv", "1.234,5;1;2\n" * 3, "line 1 .* must be numbers .*decimal points or separators, not both"),
        ("cloud.csv", "0,05,0,10,0,90\n" * 3, "line 1 of cloud.csv must be numbers .commas cannot be both decimal"),
        ("cloud.txt", "0.1|0.2|0.3\n" * 3, "line 1 of cloud.txt must be numbers, got '0.1|0.2|0.3': write 0.1 0.2"),
        ("cloud.txt", "point one\npoint two\n", "must hold lines of numbers x y z, got none: its first line is 'point"),
        ("cloud.txt", "1 2 3\0", "cloud.txt must be text in UTF-8, got a binary file: save it as text"),
        ("cloud.xyz", "1 2 3 0.5\n" * 3, "is the label and must be whole, got 0.5"),
        ("cloud.xyz", "1 2 3 1e30\n" * 3, r"is the label and must be whole, got 1e\+30"),
        ("cloud.pts", "-4\n" + "1 2 3\n" * 4, "line 1 of cloud.pts must be the number of points, got '-4'"),
        ("cloud.pts", "nan\n" + "1 2 3\n" * 4, "line 1 of cloud.pts must be the number of points, got 'nan'"),
        ("cloud.pts", "3.5\n" + "1 2 3\n" * 4, "line 1 of cloud.pts must be the number of points, got '3.5'"),
    ],
)
def test_what_is_no_cloud_is_refused(tmp_path: Path, name: str, text: str, error: str) -> None:
    with pytest.raises(ValueError, match=error):
        read_points(written(tmp_path / name, text))


def test_shapes_are_checked(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"labels must be \(4,\), got \(3,\)"):
        LabelledPoints(points=POINTS, labels=np.zeros(3, np.int64))
    with pytest.raises(FileNotFoundError):
        read_points(tmp_path / "none.xyz")
