"""Read a part's mesh from a file: bodies, unit, repair, simplification, and the sizes that perception takes."""

import logging
from pathlib import Path

import numpy as np
import trimesh

from binpick_env.parts.file_facts import FileFacts, UnitOrigin
from binpick_env.parts.mesh_bodies import bodies_of, joined, united
from binpick_env.parts.mesh_formats import read_bodies
from binpick_env.parts.mesh_repair import closed
from binpick_env.parts.simplification import simplified
from binpick_env.parts.unit import METRES, Unit, check_unit
from binpick_env.parts.walls import wall_thickness
from perception.part import diameter, require_volume
from perception.size import D_MAX as PERCEIVED
from perception.size import PLAUSIBLE
from perception.winding import outward

log = logging.getLogger(__name__)
D_MAX = (0.02, 0.2)  # range of d_max in the standard cell [m]: below, the camera sees too few points; above, no pile
LEAST_THICKNESS = 0.0002  # least thickness [m]: contacts of thinner parts are not resolved by the physics
# Shares of the surface on walls that are thinner, from which that is said, and from which the part is refused. A bore
# just below a surface leaves as thin a wall on some 2 %.
THIN_WALLS = (0.05, 0.5)
_ROUNDING = 1e-3  # share by which rounded coordinates make a wall thinner
MAX_FACES = 200_000  # number of faces above which a mesh is simplified: ray casting would take minutes
DEVIATION = 0.001  # largest deviation of a simplified mesh, as a share of its largest extent


def read_mesh(path: Path, unit: Unit | None = None) -> trimesh.Trimesh:
    """Read a watertight mesh of one body with outward normals in metres, in the file's own frame.

    Args:
        path: File of one of `binpick_env.parts.mesh_formats.SUFFIXES`.
        unit: Unit of the file's coordinates. None takes the unit that STEP and 3MF files name; for other files metres,
            else millimetres, if ``d_max`` is then 0.01 to 0.25 m.

    Returns:
        The mesh. It is repaired where that is faithful, its bodies are united, and it is simplified above `MAX_FACES`;
        the log says so. Its metadata holds the file's ``unit``, the ``sides`` of the least bounding box [m], and under
        ``facts`` how the file was read (`FileFacts`).

    Raises:
        ValueError: The file cannot be read, is empty or open, its bodies are apart, its unit is unclear, or the part is
            too large or too small for perception, or it or most of its walls are too thin for the simulation.
        FileNotFoundError: There is no such file.
    """
    meshes, named = read_bodies(path)
    for mesh in meshes:
        _require_solid(mesh, path)
    if unit is not None and named is not None:
        raise ValueError(f"{path} names its own unit: leave out --unit, in Python unit=, got {unit!r}")
    size = diameter(np.concatenate([mesh.vertices for mesh in meshes]))
    origin: UnitOrigin = "given" if unit is not None else "named" if named is not None else "guessed"
    read_as = check_unit(unit) if unit is not None else named or _guessed_unit(path, size)
    _require_size(path, size, read_as)
    mesh, bodies, repairs = _whole(meshes, path)
    scale = METRES[read_as]
    mesh.apply_transform(np.diag([scale, scale, scale, 1.0]))
    require_volume(str(path), mesh)
    if len(mesh.faces) > MAX_FACES:
        faces = len(mesh.faces)
        mesh = _of_fewer_faces(mesh, path)
        repairs.append(f"simplified from {faces} to {len(mesh.faces)} faces")
    mesh.metadata["unit"] = read_as
    mesh.metadata["facts"] = FileFacts(unit=read_as, unit_origin=origin, bodies=bodies, repairs=tuple(repairs))
    sides = np.sort(mesh.bounding_box_oriented.primitive.extents)
    if sides[0] < LEAST_THICKNESS:
        raise ValueError(
            f"{path} is {1e3 * sides[0]:.3g} mm thick, taken as {read_as}; the cell simulates parts from "
            f"{1e3 * LEAST_THICKNESS:g} mm on: thicken the part, or name another unit (--unit, in Python unit=)"
        )
    _require_walls(path, mesh, read_as)
    mesh.metadata["sides"] = tuple(float(side) for side in sides)
    return mesh


def _require_solid(mesh: trimesh.Trimesh, path: Path) -> None:
    if not np.all(np.isfinite(mesh.vertices)):
        raise ValueError(f"{path} has vertices that are not finite: export the part again")
    if np.linalg.matrix_rank(mesh.vertices - mesh.vertices[0], tol=1e-6 * float(mesh.scale)) < 3:
        raise ValueError(f"{path} is flat, but a part must enclose a volume: give the surface a thickness")


def _require_size(path: Path, size: float, read_as: str) -> None:
    metres = size * METRES[read_as]
    if PERCEIVED[0] <= metres <= PERCEIVED[1]:
        return
    raise ValueError(
        f"the largest diameter of {path} must be {PERCEIVED[0]} to {PERCEIVED[1]:g} m, got "
        f"{metres:.4g} m ({size:.4g} in the file's unit, taken as {read_as}); "
        f"--unit, in Python unit=, names another, {_readings(size)}"
    )


def _require_walls(path: Path, mesh: trimesh.Trimesh, read_as: str) -> None:
    """Refuse a part whose walls are mostly too thin for the simulation, such as a bent sheet, and warn of a few."""
    thickness = wall_thickness(mesh)
    thin = thickness[thickness < (1 - _ROUNDING) * LEAST_THICKNESS]
    share = len(thin) / len(thickness)
    if share < THIN_WALLS[0]:
        return
    about = 1e3 * float(np.median(thin))
    what = f"walls of about {about:.2g} mm on {100 * share:.0f} % of its surface, taken as {read_as}"
    advice = "thicken the walls, or name another unit (--unit, in Python unit=)"
    if share >= THIN_WALLS[1]:
        raise ValueError(f"{path} has {what}; the cell simulates walls from {1e3 * LEAST_THICKNESS:g} mm on: {advice}")
    log.warning(
        "%s has %s; contacts of walls under %g mm are not resolved: %s", path, what, 1e3 * LEAST_THICKNESS, advice
    )


def _whole(meshes: list[trimesh.Trimesh], path: Path) -> tuple[trimesh.Trimesh, int, list[str]]:
    """Return one closed body of a file's meshes, the number of bodies united in it, and what was repaired.

    The meshes may be closed each or only together.
    """
    parts = list(meshes)
    for part in parts:
        if not part.is_watertight:
            part.merge_vertices(merge_tex=True, merge_norm=True)
    if len(parts) > 1 and not all(part.is_watertight for part in parts):
        parts = [joined(parts)]
    solids = [closed(part, path) for part in parts]
    repairs = [_repair(before, after) for before, after in zip(parts, solids, strict=True) if after is not before]
    whole = united(solids, path)
    if not whole.is_volume:
        raise ValueError(
            f"the mesh of {path} must enclose a volume, got {whole.volume:.3g} with inconsistent normals: repair it, "
            "for instance in MeshLab"
        )
    return whole, sum(len(bodies_of(outward(solid))) for solid in solids), repairs


def _repair(before: trimesh.Trimesh, after: trimesh.Trimesh) -> str:
    """Return in words what closing a mesh changed."""
    counts = np.unique(before.edges_sorted, axis=0, return_counts=True)[1]
    grown = 100 * (float(after.area) / float(before.area) - 1)
    lone, crowded = int(np.sum(counts == 1)), int(np.sum(counts > 2))
    what = f"{lone} open edges closed" if lone else f"{crowded} edges of more than two faces separated"
    return f"{what}, which changed the surface's area by {grown:+.2g} %"


def _of_fewer_faces(mesh: trimesh.Trimesh, path: Path) -> trimesh.Trimesh:
    tolerance = DEVIATION * float(np.linalg.norm(mesh.extents))
    coarse = simplified(mesh, tolerance)
    if coarse is None or len(coarse.faces) > MAX_FACES:
        left = "none" if coarse is None else str(len(coarse.faces))
        raise ValueError(
            f"a part may have up to {MAX_FACES} faces, {path} has {len(mesh.faces)}, and could not be simplified to so "
            f"few within {1e3 * tolerance:.2g} mm (faces left: {left}): export it more coarsely; 20000 faces are plenty"
        )
    log.warning(
        "%s has %d faces; it was simplified to %d, which deviate by at most %.3f mm",
        path,
        len(mesh.faces),
        len(coarse.faces),
        1e3 * coarse.metadata.pop("deviation"),
    )
    return coarse


def _guessed_unit(path: Path, size: float) -> str:
    """Return the unit that gives the part a plausible size; most mesh files name none."""
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
