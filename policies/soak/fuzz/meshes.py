"""Malformed part files: damaged STL, OBJ, PLY and OFF, bodies that are no solids, sizes in other units."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from binpick_env.parts import load_part
from binpick_env.parts.hull import is_nearly_convex
from binpick_env.parts.mesh_file import read_mesh
from policies.soak.fuzz.damage import choose, damaged_array, damaged_bytes, damaged_text
from policies.soak.fuzz.grammar import Case
from policies.soak.fuzz.samples import Samples

SUFFIXES = (".stl", ".obj", ".ply", ".off")


def mesh(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:  # noqa: ARG001 - the form of a grammar
    """A block or a cylinder with damage to its surface, its unit or its file."""
    solid = _solid(rng)
    suffix = choose(rng, SUFFIXES)
    content = solid.export(file_type=suffix[1:])
    raw = content.encode() if isinstance(content, str) else bytes(content)
    damage = int(rng.integers(4))
    if damage == 0:
        raw = damaged_bytes(rng, raw)
    elif damage == 1 and isinstance(content, str):
        raw = damaged_text(rng, content).encode()
    elif damage == 2:
        suffix = choose(rng, (*SUFFIXES, ".glb", ".3mf", ".step", ".txt", ""))
    path = folder / f"part{suffix}"
    path.write_bytes(raw)
    unit = choose(rng, (None, None, "mm", "m", "inch", "furlong"))
    density = choose(rng, (None, None, -1.0, 0.0, float("nan"), 1e12))
    return lambda: _read(path, unit, density)


def _read(path: Path, unit: Any, density: float | None) -> object:
    """Read a part file, whole where that is quick: the convex decomposition may take longer than a case's limit."""
    mesh = read_mesh(path, unit)
    if not is_nearly_convex(mesh):
        return mesh
    return load_part(str(path), unit=unit, density=density)


def _solid(rng: np.random.Generator) -> trimesh.Trimesh:
    """Return a block or a cylinder in millimetres, of which something may be wrong."""
    if rng.random() < 0.5:
        solid = trimesh.creation.box(rng.uniform(20, 80, 3))
    else:
        solid = trimesh.creation.cylinder(rng.uniform(8, 30), rng.uniform(20, 80), sections=int(rng.integers(3, 20)))
    vertices, faces = np.array(solid.vertices), np.array(solid.faces)
    match int(rng.integers(7)):
        case 0:
            faces = faces[: int(rng.integers(len(faces)))]
        case 1:
            vertices[int(rng.integers(len(vertices)))] = choose(rng, (np.nan, np.inf, 0.0, 1e6))
        case 2:
            vertices = vertices * choose(rng, (1e-6, 1e-3, 1e3, 1e6, 0.0))
        case 3:
            vertices[:, int(rng.integers(3))] *= choose(rng, (0.0, 1e-3, -1.0))
        case 4:
            values = damaged_array(rng, vertices)
            if values.shape == vertices.shape and values.dtype.kind == "f":
                vertices = np.asarray(values, np.float64)
        case 5:
            flipped = rng.random(len(faces)) < 0.3
            faces[flipped] = faces[flipped][:, ::-1]
        case _:
            pass
    return trimesh.Trimesh(vertices, faces, process=False)
