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


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply", ".glb", ".3mf"])
def test_half_a_file_is_said_to_be_damaged(tmp_path: Path, suffix: str) -> None:
    whole = ell().export(file_type=suffix[1:])
    content = whole.encode() if isinstance(whole, str) else whole
    path = stored(tmp_path / f"part{suffix}", content[: len(content) // 2])
    with pytest.raises(ValueError, match=rf"part\{suffix} .* truncated or damaged \(.*\); export or copy it again"):
        read_mesh(path)


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
