"""Files in the encodings and line ends that programs write, and what damaged ones are said to be."""

from pathlib import Path

import pytest
import trimesh

from binpick_env.parts.mesh_file import read_mesh
from tests.binpick_env.parts.part_meshes import ell

WHOLE = {".stl": "stl_ascii", ".obj": "obj", ".off": "off"}


def content_of(suffix: str) -> str:
    return str(ell().export(file_type=WHOLE[suffix]))


def stored(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".off"])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_byte_order_mark_names_the_encoding(tmp_path: Path, suffix: str, encoding: str) -> None:
    path = stored(tmp_path / f"part{suffix}", content_of(suffix).encode(encoding))
    assert read_mesh(path).volume == pytest.approx(ell().volume, rel=1e-5)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".off"])
def test_carriage_returns_alone_end_lines(tmp_path: Path, suffix: str) -> None:
    path = stored(tmp_path / f"part{suffix}", content_of(suffix).replace("\n", "\r").encode())
    assert read_mesh(path).volume == pytest.approx(ell().volume, rel=1e-5)


def test_a_text_stl_in_capitals(tmp_path: Path) -> None:
    path = stored(tmp_path / "part.stl", content_of(".stl").upper().encode())
    assert read_mesh(path).volume == pytest.approx(ell().volume, rel=1e-5)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb", ".3mf"])
def test_half_a_file_is_said_to_be_damaged(tmp_path: Path, suffix: str) -> None:
    whole = ell().export(file_type=suffix[1:])
    content = whole.encode() if isinstance(whole, str) else whole
    path = stored(tmp_path / f"part{suffix}", content[: len(content) // 2])
    with pytest.raises(ValueError, match=rf"part\{suffix} .* truncated or damaged \(.*\); export or copy it again"):
        read_mesh(path)


def counted(kind: str) -> list[str]:
    """Return the lines of a text file whose header counts what follows."""
    whole = ell().export(file_type="off") if kind.endswith("off") else ell().export(file_type="ply", encoding="ascii")
    lines = (whole if isinstance(whole, str) else whole.decode()).strip().splitlines()
    return [f"OFF {lines[1]}", "# made by hand", "", *lines[2:]] if kind == "one line.off" else lines


@pytest.mark.parametrize("kind", ["off", "one line.off", "ply"])
@pytest.mark.parametrize("missing", [1, 6, 25])
def test_fewer_vertices_or_faces_than_announced_are_said_to_be_truncated(
    tmp_path: Path, kind: str, missing: int
) -> None:
    """A hole of one face would be closed without a word of the file's end."""
    whole = ell()
    lines = counted(kind)
    path = stored(tmp_path / f"part.{kind}", "\n".join(lines).encode())
    assert read_mesh(path).volume == pytest.approx(whole.volume, rel=1e-5)
    stored(path, "\n".join(lines[:-missing]).encode())
    vertices, faces = len(whole.vertices), len(whole.faces)
    text = f"its header announces {vertices} vertices and {faces} faces, one a line, and {vertices + faces - missing} l"
    with pytest.raises(ValueError, match=f"it is truncated: {text}ines follow; export or copy it again"):
        read_mesh(path)


@pytest.mark.parametrize("kind", ["off", "ply"])
def test_a_last_face_without_its_last_corner_is_said_to_be_truncated(tmp_path: Path, kind: str) -> None:
    cut = "\n".join(counted(kind)).rsplit(" ", 1)[0]
    with pytest.raises(
        ValueError, match=r"the last one of \d+ vertices and \d+ faces must have 3 corners, got 2; expo"
    ):
        read_mesh(stored(tmp_path / f"part.{kind}", cut.encode()))


def test_more_properties_and_elements_of_a_text_ply_are_read(tmp_path: Path) -> None:
    lines = counted("ply")
    end = lines.index("end_header")
    faces = [f"{line} 200" if n >= end + 1 + len(ell().vertices) else line for n, line in enumerate(lines)]
    header = [*faces[:end], "property uchar red", "element edge 1", "property int vertex1", "end_header"]
    path = stored(tmp_path / "part.ply", "\n".join([*header, *faces[end + 1 :], "0", ""]).encode())
    assert read_mesh(path).volume == pytest.approx(ell().volume, rel=1e-5)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".off", ".ply"])
def test_decimal_commas_are_named(tmp_path: Path, suffix: str) -> None:
    text = "\n".join(counted("ply")) if suffix == ".ply" else content_of(suffix)
    head, number, rest = text.partition("0.0")
    comma = head + (number + rest).replace(".", ",")
    with pytest.raises(
        ValueError, match=r"must have decimal points, got decimal commas, such as (-?\d+),(\d+) for \1\.\2: "
    ):
        read_mesh(stored(tmp_path / f"part{suffix}", comma.replace("\n", "\r\n").encode()))


def test_commas_elsewhere_are_no_decimal_ones(tmp_path: Path) -> None:
    text = f"# made by 1,5 2,5 3,5 Sons, Ltd\no part 1,2 of 3\n{content_of('.obj')}"
    assert read_mesh(stored(tmp_path / "part.obj", text.encode())).volume == pytest.approx(ell().volume, rel=1e-5)


def test_less_than_a_header_is_said_to_be_so(tmp_path: Path) -> None:
    path = stored(tmp_path / "part.stl", b"\0" * 60)
    with pytest.raises(ValueError, match=r"has 60 bytes, fewer than the 84 of .* header; export or copy it again"):
        read_mesh(path)


def test_points_alone_are_no_part(tmp_path: Path) -> None:
    lines = [line for line in content_of(".obj").splitlines() if line.startswith("v ")]
    path = stored(tmp_path / "part.obj", "\n".join(lines).encode())
    with pytest.raises(ValueError, match=r"part\.obj holds no triangles: export the part as a mesh of its surface"):
        read_mesh(path)


def test_a_thin_part_names_its_unit_and_what_to_do(tmp_path: Path) -> None:
    trimesh.creation.box((60.0, 40.0, 0.05)).export(tmp_path / "foil.stl")
    with pytest.raises(ValueError, match=r"0\.05 mm thick, taken as mm; .* thicken the part, or name another unit"):
        read_mesh(tmp_path / "foil.stl")
