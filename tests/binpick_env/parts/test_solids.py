"""Work of manifold3d in a process of its own: its results, and ends of the process that are none of its doing."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.parts.solids import Mesh, collapse, triangulate, unite

OUTLINE = np.array([(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)], float)  # an L


def cube(x: float = 0.0) -> Mesh:
    box = trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix((x, 0, 0)))
    return np.asarray(box.vertices, np.float64), np.asarray(box.faces, np.int64)


def test_a_union_and_its_groups() -> None:
    joint = unite([cube(), cube(0.9), cube(3.0)], gap=1e-6, tolerance=0.0)
    assert joint is not None
    assert trimesh.Trimesh(*joint.mesh).volume == pytest.approx(2.9)
    assert joint.groups == 2


def test_a_body_that_is_open_makes_no_union() -> None:
    vertices, faces = cube()
    assert unite([cube(), (vertices, faces[1:])], gap=0.0, tolerance=0.0) is None
    assert collapse((vertices, faces[1:]), 0.01) is None


def test_outlines_are_filled() -> None:
    outlines = [OUTLINE, OUTLINE[:3], OUTLINE[:2:-1] * (-1, 1), 2 * OUTLINE]
    fillings = triangulate(outlines)
    for outline, filling, area in zip(outlines, fillings, (6.0, 2.0, 1.0, 24.0), strict=True):
        x, y = outline[filling].T  # (3, T) each
        areas = 0.5 * ((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]))
        assert areas.sum() == pytest.approx(area)
        assert (areas > 0).all()
    assert triangulate([]) == []


@pytest.mark.parametrize(
    ("task", "what"),
    [
        (lambda program: unite([cube(), cube()], gap=0.0, tolerance=0.0, program=program), "the union of 2 bodies"),
        (lambda program: collapse(cube(), 0.1, program=program), "the simplification of a mesh of 12 faces"),
        (lambda program: triangulate([OUTLINE], program=program), "the filling of holes with 6 edges"),
    ],
)
def test_an_end_by_a_signal_is_an_error(tmp_path: Path, task: Callable[[Path], object], what: str) -> None:
    (tmp_path / "program.py").write_text("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    with pytest.raises(ValueError, match=f"{what} ended by signal SIGSEGV: its surfaces .* export the part as one"):
        task(tmp_path / "program.py")
