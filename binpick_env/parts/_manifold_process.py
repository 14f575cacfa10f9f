"""Work of manifold3d on meshes of files as a program of its own, since it may end its process by a signal.

`main` reads arrays from an .npz file and writes others. A mesh is given by ``vertices`` and ``faces``; several ones
follow each other there, each with its numbers of both in a row of ``counts``. `unite` and `simplify` leave ``vertices``
out where manifold3d takes a mesh for no closed solid.
"""

from typing import Any

import manifold3d
import numpy as np

Arrays = dict[str, Any]
_WIDTH = 100.0  # gaps; narrower contacts are edges: two cubes enlarged by a gap overlap by two gaps along an edge


def main(task: str, source: str, target: str) -> None:
    """Do one task: ``unite``, ``simplify`` or ``triangulate``."""
    with np.load(source) as stored:
        arrays = {name: stored[name] for name in stored.files}
    np.savez(target, **{"unite": unite, "simplify": simplify, "triangulate": triangulate}[task](arrays))


def unite(arrays: Arrays) -> Arrays:
    """Return the union of bodies, and the (P, 2) ``pairs`` of those that overlap or share some face.

    The bodies are enlarged by ``gap``, of 0 or more, so that those in contact overlap. The union is simplified within
    ``tolerance``. Without a gap there are no pairs.
    """
    ends = np.cumsum(arrays["counts"], axis=0)[:-1]
    parts = zip(np.split(arrays["vertices"], ends[:, 0]), np.split(arrays["faces"], ends[:, 1]), strict=True)
    solids = [solid for vertices, faces in parts if (solid := _solid(vertices, faces)) is not None]
    if len(solids) < len(arrays["counts"]):
        return {}
    whole = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)
    gap, tolerance = float(arrays["gap"]), float(arrays["tolerance"])
    pairs = np.array(_pairs(solids, gap) if gap > 0 else [], np.int64).reshape(-1, 2)
    return _mesh(whole.simplify(tolerance) if tolerance else whole) | {"pairs": pairs}


def simplify(arrays: Arrays) -> Arrays:
    """Return a mesh with short edges collapsed within ``tolerance``."""
    solid = _solid(arrays["vertices"], arrays["faces"])
    return {} if solid is None else _mesh(solid.simplify(float(arrays["tolerance"])))


def triangulate(arrays: Arrays) -> Arrays:
    """Return the ``triangles`` within ``outlines`` that turn left, which have ``lengths``, and their ``counts``."""
    outlines = np.split(arrays["outlines"], np.cumsum(arrays["lengths"])[:-1])
    triangles = [manifold3d.triangulate([np.ascontiguousarray(outline)]) for outline in outlines]
    counts = np.array([len(filling) for filling in triangles], np.int64)
    whole = [np.asarray(filling, np.int64).reshape(-1, 3) for filling in triangles]
    return {"triangles": np.concatenate(whole), "counts": counts}


def _solid(vertices: Any, faces: Any) -> manifold3d.Manifold | None:
    mesh = manifold3d.Mesh64(np.asarray(vertices, np.float64), np.asarray(faces, np.uint64))
    solid = manifold3d.Manifold(mesh)
    return solid if solid.status() == manifold3d.Error.NoError and not solid.is_empty() else None


def _mesh(solid: manifold3d.Manifold) -> Arrays:
    mesh = solid.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, np.float64)[:, :3]
    return {"vertices": vertices, "faces": np.asarray(mesh.tri_verts, np.int64)}


def _pairs(solids: list[manifold3d.Manifold], gap: float) -> list[tuple[int, int]]:
    boxes = np.array([solid.bounding_box() for solid in solids])
    low, high = boxes[:, :3], boxes[:, 3:]
    near = np.all((low[:, None] <= high) & (low <= high[:, None]), axis=2)
    return [(i, j) for i, j in np.argwhere(np.triu(near, 1)).tolist() if _joined(solids[i], solids[j], gap)]


def _joined(one: manifold3d.Manifold, other: manifold3d.Manifold, gap: float) -> bool:
    """Tell whether the overlap of two enlarged bodies, two gaps thick on a common face, is wide somewhere."""
    for overlap in (one ^ other).decompose():
        box = np.array(overlap.bounding_box())
        length = float(np.linalg.norm(box[3:] - box[:3]))
        if overlap.volume() / (2 * gap) > _WIDTH * gap * length:
            return True
    return False
