"""The file formats of parts: what each of them gives, and files that are not what their name says."""

import io
import tempfile
from pathlib import Path

import numpy as np
import trimesh

from binpick_env.parts.child_program import run_program
from binpick_env.parts.text_checks import RefusedError, require_decimal_points, require_whole_off, require_whole_ply
from perception.capture.text_files import as_utf8

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb", ".3mf", ".step", ".stp")
_STEP = Path(__file__).with_name("_step_process.py")
_DEFLECTION_MM = 0.02  # largest distance of a facet from the curved surface of a STEP file [mm]
_ANGLE = 0.2  # largest angle between neighbouring facets of a STEP file [rad]
_STEP_TIMEOUT = 600.0  # time after which the tessellation is given up [s]
_BEGINNINGS = {b"ISO-10303-21": ".step", b"glTF": ".glb", b"PK\x03\x04": ".3mf", b"ply": ".ply", b"OFF": ".off"}
_UNITS_3MF = {"micron": 1e-6, "millimeter": 0.001, "centimeter": 0.01, "inch": 0.0254, "foot": 0.3048, "meter": 1.0}
_POLYGONS = (".obj", ".ply", ".off")  # formats whose faces may have more than three corners
_SLIVER = 1e-5  # height of a triangle, as a share of the mesh's size, below which its normal means nothing
_STL_HEADER, _STL_FACE = 84, 50  # lengths of a binary STL's header and of a triangle [bytes]


def read_bodies(path: Path) -> tuple[list[trimesh.Trimesh], str | None]:
    """Read the meshes of a file, as many as it holds, each with its own placement applied.

    Args:
        path: File of one of `SUFFIXES`; the suffix's case does not matter.

    Returns:
        The meshes, and the unit that the format names: "m" for STEP and 3MF, whose units are converted; else None.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The suffix or the content is none of these formats, or the content is damaged or empty.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"a part's file must end in {', '.join(SUFFIXES)}, got {path}")
    if not path.is_file():
        raise FileNotFoundError(f"there is no part file {path}")
    data = path.read_bytes()
    _require_content(path, data)
    try:
        meshes, unit = _parsed(suffix, data)
    except RefusedError as error:
        raise ValueError(f"{path} cannot be read as a {path.suffix} mesh: {error}") from error
    except Exception as error:  # the readers raise whatever their parsing meets
        raise ValueError(
            f"{path} cannot be read as a {path.suffix} mesh: it seems to be truncated or damaged ({error}); "
            "export or copy it again"
        ) from error
    meshes = [mesh for mesh in meshes if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not meshes:
        raise ValueError(f"{path} holds no triangles: export the part as a mesh of its surface")
    if suffix in _POLYGONS:
        for mesh in meshes:
            _require_unfolded(path, mesh)
    return meshes, unit


def _require_content(path: Path, data: bytes) -> None:
    """Refuse a file whose content is of another format than its name says."""
    beginning = data[:512].lstrip()
    for signature, suffix in _BEGINNINGS.items():
        named = ".step" if path.suffix.lower() == ".stp" else path.suffix.lower()
        if beginning.startswith(signature) and named != suffix:
            raise ValueError(f"{path} is not what its name says: its content is that of a {suffix} file; rename it")
    if path.suffix.lower() in (".step", ".stp") and not beginning.startswith(b"ISO-10303-21"):
        raise ValueError(f"{path} is no STEP file: it must begin with ISO-10303-21, got {bytes(beginning[:16])!r}")


def _require_unfolded(path: Path, mesh: trimesh.Trimesh) -> None:
    """Refuse neighbouring triangles that lie on each other: concave polygons that were read as fans of triangles."""
    edges = mesh.vertices[mesh.face_adjacency_edges]
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    along = (edges[:, 1] - edges[:, 0]) / np.maximum(lengths, 1e-300)[:, None]
    across = mesh.vertices[mesh.face_adjacency_unshared] - edges[:, :1]
    across = across - np.einsum("nki,ni->nk", across, along)[:, :, None] * along[:, None]
    heights = np.linalg.norm(across, axis=2)
    cosines = np.einsum("ni,ni->n", across[:, 0], across[:, 1]) / np.maximum(heights.prod(axis=1), 1e-300)
    thick = (heights > _SLIVER * float(mesh.scale)).all(axis=1)
    count = int(np.count_nonzero(thick & (cosines > 1 - 1e-6)))  # both on one side of their edge, whatever the winding
    if count:
        raise ValueError(
            f"{path} has {count} pairs of neighbouring triangles that lie on each other, which happens where a concave "
            "face has more than three corners: triangulate the faces when exporting the model"
        )


def _parsed(suffix: str, data: bytes) -> tuple[list[trimesh.Trimesh], str | None]:
    if suffix in (".step", ".stp"):
        return _step(data), "m"
    if suffix == ".3mf":
        return _three_mf(data), "m"
    if suffix == ".glb":
        return _placed(trimesh.load_scene(io.BytesIO(data), file_type="glb")), None
    if suffix == ".stl":
        content, kind = _stl(data)
        return [trimesh.load_mesh(io.BytesIO(content), file_type=kind)], None
    if suffix == ".obj":
        text = _text(data)
        require_decimal_points(text)
        return [trimesh.load_mesh(io.BytesIO(text), file_type="obj")], None
    if suffix == ".ply":
        content = _without_comments(data)
        require_whole_ply(content)
        return [trimesh.load_mesh(io.BytesIO(content), file_type="ply")], None
    text = _text(data)
    require_decimal_points(text)
    require_whole_off(text)
    return [trimesh.load_mesh(io.BytesIO(text), file_type="off")], None


def _stl(data: bytes) -> tuple[bytes, str]:
    """Return the content of an STL without what follows its triangles, and trimesh's name of its kind."""
    content = _text(data)
    begin = content[:4096].lower()
    if begin.lstrip().startswith(b"solid") and b"facet" in begin:
        text = content.lower()
        begun, ended, closed = (text.count(word) for word in (b"facet normal", b"endfacet", b"endsolid"))
        if begun > ended or not closed:
            rest = "" if closed else " and endsolid is missing"
            raise RefusedError(f"it is truncated: {begun} facets begin, {ended} end{rest}; export or copy it again")
        require_decimal_points(text)
        return text, "stl_ascii"
    if len(data) < _STL_HEADER:
        raise RefusedError(
            f"it has {len(data)} bytes, fewer than the {_STL_HEADER} of a binary STL's header; export or copy it again"
        )
    count = int(np.frombuffer(data, "<u4", 1, 80)[0])
    length = _STL_HEADER + _STL_FACE * count
    if len(data) < length:
        raise RefusedError(
            f"it is truncated: its header announces {count} triangles, which take {length} bytes, "
            f"and it has {len(data)}; export or copy it again"
        )
    return data[:length], "stl"


def _text(data: bytes) -> bytes:
    """Return a text in UTF-8 and with line feeds: it may be in UTF-16, in Latin-1, or have carriage returns alone."""
    text = as_utf8(data, "it")
    try:
        text.decode("utf-8")
    except UnicodeDecodeError:
        text = text.decode("latin-1").encode("utf-8")
    return text if b"\n" in text else text.replace(b"\r", b"\n")


def _without_comments(data: bytes) -> bytes:
    """Return the content of a PLY without its header's comments, which may be in Latin-1 and in any place."""
    header, end, body = data.partition(b"end_header")
    lines = [line for line in header.splitlines(keepends=True) if not line.startswith((b"comment", b"obj_info"))]
    return b"".join(lines) + end + body


def _step(data: bytes) -> list[trimesh.Trimesh]:
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "part.step", Path(folder) / "part.glb"
        source.write_bytes(data)
        arguments = str(source), str(target), str(_DEFLECTION_MM), str(_ANGLE)
        advice = "the file may be damaged; export it again"
        run_program(_STEP, arguments, what="the tessellation", advice=advice, timeout=_STEP_TIMEOUT)
        return _placed(trimesh.load_scene(target))


def _three_mf(data: bytes) -> list[trimesh.Trimesh]:
    scene = trimesh.load_scene(io.BytesIO(data), file_type="3mf")
    unit = str(scene.metadata.get("units", "millimeter")).removesuffix("s")
    if unit not in _UNITS_3MF:
        raise RefusedError(f"its unit must be one of {', '.join(_UNITS_3MF)}, got {unit!r}")
    scale = _UNITS_3MF[unit]
    return [mesh.apply_transform(np.diag([scale, scale, scale, 1.0])) for mesh in _placed(scene)]


def _placed(scene: trimesh.Scene) -> list[trimesh.Trimesh]:
    """Return a copy of each mesh of a scene, in the scene's frame."""
    return [mesh.copy() for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
