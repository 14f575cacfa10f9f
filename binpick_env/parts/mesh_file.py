"""Read a part's mesh from a file: unit, repair, and the checks that a simulated part must pass."""

import logging
from pathlib import Path

import numpy as np
import trimesh

from binpick_env.parts.unit import METRES, Unit, check_unit
from perception.part import diameter

log = logging.getLogger(__name__)
SUFFIXES = (".stl", ".obj", ".ply")
PLAUSIBLE = (0.01, 0.25)  # range of d_max in which a guessed unit must put a part [m]
D_MAX = (0.02, 0.2)  # range of d_max [m]: below, the camera sees too few points; above, no bin of the cell holds a pile
MAX_FACES = 200_000  # largest number of faces; with more, ray casting and the symmetry search take minutes
JAW = 0.075  # widest side that the 2F-85 closes on [m]: 85 mm less 5 mm on each side for the pose's error


def read_mesh(path: Path, unit: Unit | None = None) -> trimesh.Trimesh:
    """Read a watertight mesh with outward normals in metres, in the file's own frame.

    Args:
        path: STL, OBJ or PLY file.
        unit: Unit of the file's coordinates. None takes metres, else millimetres, if ``d_max`` is then 0.01 to 0.25 m.

    Returns:
        The mesh, repaired where merging vertices, filling small holes and turning normals is enough; ``unit`` in its
        metadata is the unit of the file.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file cannot be read, is empty, open, too large, too small or too fine, or its unit is unclear.
    """
    mesh = _parse(path)
    size = diameter(mesh.vertices)
    read_as = check_unit(unit) if unit is not None else _guessed_unit(path, size)
    scale = METRES[read_as]
    if not D_MAX[0] <= size * scale <= D_MAX[1]:
        raise ValueError(
            f"the largest diameter of {path} must be {D_MAX[0]} to {D_MAX[1]} m, got {size * scale:.4g} m "
            f"({size:.4g} in the file's unit, taken as {read_as}); "
            f"--unit, in Python unit=, names another, {_readings(size)}"
        )
    mesh.apply_transform(np.diag([scale, scale, scale, 1.0]))
    _repair(mesh, path)
    mesh.metadata["unit"] = read_as
    side = float(min(mesh.bounding_box_oriented.extents))
    if side > JAW:
        log.warning(
            "no side of %s is under %.0f mm (the smallest: %.0f mm): the jaw cannot grasp it",
            path,
            JAW * 1e3,
            side * 1e3,
        )
    return mesh


def _parse(path: Path) -> trimesh.Trimesh:
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"a part's file must end in {', '.join(SUFFIXES)}, got {path}")
    if not path.is_file():
        raise FileNotFoundError(f"there is no part file {path}")
    try:
        mesh = trimesh.load_mesh(path)
    except Exception as error:  # the readers raise whatever their parsing meets
        raise ValueError(f"{path} cannot be read as a {path.suffix} mesh: {error}") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise ValueError(f"{path} holds no triangles")
    if len(mesh.faces) > MAX_FACES:
        raise ValueError(
            f"a part may have up to {MAX_FACES} faces, {path} has {len(mesh.faces)}: simplify it first, for instance "
            "with MeshLab's quadric edge collapse or trimesh's simplify_quadric_decimation; 20000 faces are plenty"
        )
    if not np.all(np.isfinite(mesh.vertices)):
        raise ValueError(f"{path} has vertices that are not finite")
    if np.linalg.matrix_rank(mesh.vertices - mesh.vertices[0], tol=1e-6 * float(mesh.scale)) < 3:
        raise ValueError(f"{path} is flat: a part must enclose a volume")
    return mesh


def _guessed_unit(path: Path, size: float) -> str:
    """Return the unit that gives the part a plausible size; mesh files name none."""
    for unit in ("m", "mm"):
        if PLAUSIBLE[0] <= size * METRES[unit] <= PLAUSIBLE[1]:
            if unit == "mm":
                log.info("%s is taken to be in millimetres: its largest diameter is %.4g", path, size)
            return unit
    raise ValueError(
        f"the unit of {path} is unclear: its largest diameter is {size:.4g}, and a part's should be {PLAUSIBLE[0]} to "
        f"{PLAUSIBLE[1]} m; name the unit (--unit, in Python unit=), {_readings(size)}"
    )


def _readings(size: float) -> str:
    return "which would make it " + ", ".join(f"{size * scale:.3g} m as {unit!r}" for unit, scale in METRES.items())


def _repair(mesh: trimesh.Trimesh, path: Path) -> None:
    """Close and orient ``mesh`` in place, or say what is still open."""
    if not mesh.is_watertight:
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
        mesh.fill_holes()
        if mesh.is_watertight:
            log.warning("%s was not watertight; merging vertices and filling holes closed it", path)
    if not mesh.is_watertight:
        counts = np.unique(mesh.edges_sorted, axis=0, return_counts=True)[1]
        lone, crowded = int(np.sum(counts == 1)), int(np.sum(counts > 2))
        raise ValueError(
            f"the mesh of {path} must be watertight (every edge shared by two faces): after repair "
            f"{lone} of {len(counts)} edges are open and {crowded} are shared by three faces or more"
        )
    mesh.fix_normals()
    if mesh.volume < 0:
        mesh.invert()
    if not mesh.is_volume:
        raise ValueError(
            f"the mesh of {path} must enclose a volume, got {mesh.volume:.3g} m^3 with inconsistent normals"
        )
