"""Unions, simplification and triangulation by manifold3d, in a process of its own."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from binpick_env.parts.child_program import run_program
from perception.geometry import Floats

PROGRAM = Path(__file__).with_name("_manifold_process.py")
Mesh = tuple[Floats, NDArray[np.int64]]  # (V, 3) vertices and (F, 3) faces
_TIMEOUT = 1800.0  # time after which a task is given up [s]
_ADVICE = "its surfaces may cross each other; export the part as one solid, or repair it, for instance in MeshLab"


@dataclass(frozen=True, eq=False, kw_only=True)
class Union:
    """A union of bodies.

    Attributes:
        mesh: Vertices and faces.
        groups: Number of groups of bodies that overlap or share some face; an edge or a point is no joint. It is that
            of the bodies themselves if they were not enlarged.
    """

    mesh: Mesh
    groups: int


def unite(bodies: Sequence[Mesh], *, gap: float, tolerance: float, program: Path = PROGRAM) -> Union | None:
    """Return the union of bodies; None if one of them is no closed solid.

    Args:
        bodies: Vertices and faces of each body.
        gap: Distance by which the bodies were enlarged, so that those in contact overlap.
        tolerance: Length of edges that are collapsed in the union; 0 for none.
        program: Python file that is run; see :mod:`._manifold_process`.

    Raises:
        ValueError: The program ends by a signal, fails, or takes too long.
    """
    found = _call(
        "unite",
        f"the union of {len(bodies)} bodies",
        program,
        vertices=np.concatenate([vertices for vertices, _ in bodies]),
        faces=np.concatenate([faces for _, faces in bodies]),
        counts=np.array([(len(vertices), len(faces)) for vertices, faces in bodies], np.int64),
        gap=gap,
        tolerance=tolerance,
    )
    if "vertices" not in found:
        return None
    first, second = found["pairs"].T
    links = coo_matrix((np.ones(len(first)), (first, second)), shape=(len(bodies),) * 2)
    groups = int(connected_components(links, directed=False)[0])
    return Union(mesh=(found["vertices"], found["faces"]), groups=groups)


def collapse(mesh: Mesh, tolerance: float, *, program: Path = PROGRAM) -> Mesh | None:
    """Return a mesh with short edges collapsed within ``tolerance``; None if it is no closed solid.

    Raises:
        ValueError: The program ends by a signal, fails, or takes too long.
    """
    vertices, faces = mesh
    what = f"the simplification of a mesh of {len(faces)} faces"
    found = _call("simplify", what, program, vertices=vertices, faces=faces, tolerance=tolerance)
    return (found["vertices"], found["faces"]) if "vertices" in found else None


def triangulate(outlines: Sequence[Floats], *, program: Path = PROGRAM) -> list[NDArray[np.int64]]:
    """Return the (T, 3) triangles within each of some (N, 2) outlines that turn left.

    Raises:
        ValueError: The program ends by a signal, fails, or takes too long.
    """
    triangles = [np.arange(3)[None] for _ in outlines]
    wide = [k for k, outline in enumerate(outlines) if len(outline) > 3]
    if wide:
        lengths = np.array([len(outlines[k]) for k in wide])
        found = _call(
            "triangulate",
            f"the filling of holes with {lengths.sum()} edges",
            program,
            outlines=np.concatenate([outlines[k] for k in wide]),
            lengths=lengths,
        )
        for k, filling in zip(wide, np.split(found["triangles"], np.cumsum(found["counts"])[:-1]), strict=True):
            triangles[k] = filling
    return triangles


def _call(task: str, what: str, program: Path, **arrays: Any) -> dict[str, NDArray[Any]]:
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "given.npz", Path(folder) / "found.npz"
        np.savez(source, allow_pickle=False, **arrays)
        run_program(program, (task, str(source), str(target)), what=what, advice=_ADVICE, timeout=_TIMEOUT)
        with np.load(target) as found:
            return {name: found[name] for name in found.files}
