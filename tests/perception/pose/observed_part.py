"""An L-shaped block without symmetry as wires and as a depth image, and poses beside the true one."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from perception.frame import Frame
from perception.geometry import Floats, make_transform, random_rotation, rotation_about
from perception.part import PartModel, Symmetry
from perception.pose.model.edge_models import EdgeModel
from perception.pose.verification.boundary_index import BoundaryIndex, index_boundary

SIZE = (240, 180)  # width, height [px]
# Neither square pixels nor a centred principal point: a test fails if a kernel swaps the axes.
K = np.array([[1200.0, 0.0, 124.5], [0.0, 1250.0, 84.5], [0.0, 0.0, 1.0]])
DISTANCE, FLOOR = 0.5, 0.56  # depth of the part's centre and of the floor [m]
HEIGHT = 0.014
OUTLINE = np.array([(0.0, 0.0), (0.06, 0.0), (0.06, 0.02), (0.02, 0.02), (0.02, 0.045), (0.0, 0.045)])
SIGMA = 0.0003  # of a good sensor [m]


def ell(symmetry: Symmetry | None = None) -> PartModel:
    """The outline above, extruded, with its drawing's origin in a corner."""
    n = len(OUTLINE)
    vertices = [(x, y, z) for z in (0.0, HEIGHT) for x, y in OUTLINE]
    top = [(n, n + i, n + i + 1) for i in range(1, n - 1)]
    bottom = [(0, i + 1, i) for i in range(1, n - 1)]
    sides = [f for i in range(n) for j in [(i + 1) % n] for f in ((i, j, n + j), (i, n + j, n + i))]
    return PartModel.from_mesh("ell", trimesh.Trimesh(vertices, top + bottom + sides), symmetry)


def wires(part: PartModel, spacing: float) -> tuple[Floats, Floats]:
    """Return (M, 3) points on the sharp edges of a part and (M, 3) tangents."""
    sharp = part.mesh.face_adjacency_edges[part.mesh.face_adjacency_angles > 0.5]
    points, tangents = [], []
    for a, b in np.asarray(part.mesh.vertices)[sharp]:
        steps = max(int(np.linalg.norm(b - a) / spacing), 1)
        points.append(a + (b - a) * ((np.arange(steps) + 0.5) / steps)[:, None])
        tangents.append(np.repeat((b - a)[None] / np.linalg.norm(b - a), steps, axis=0))
    return np.concatenate(points), np.concatenate(tangents)


def all_visible(points: Floats, tangents: Floats, part: PartModel) -> EdgeModel:
    """Return these edges as those of a part that shows them all from everywhere."""
    return EdgeModel(
        points=points,
        tangents=tangents,
        visibility=np.ones(len(points), np.uint32),
        views=np.array([[0.0, 0.0, 1.0]]),
        centre=part.centre,
        d_max=part.d_max,
    )


def wire_model(part: PartModel) -> EdgeModel:
    """Return all sharp edges of a part as its edge model."""
    return all_visible(*wires(part, 0.002), part)


def wire_scene(
    T: Floats, part: PartModel, rng: np.random.Generator, *, noise: float = 0.0, keep: NDArray[np.bool_] | None = None
) -> tuple[Floats, Floats]:
    """Return (N, 3) boundary points of a part's wires and their tangents of random sign; ``keep`` is over N."""
    points, tangents = wires(part, 0.0005)
    points_cam = points @ T[:3, :3].T + T[:3, 3] + noise * rng.normal(size=points.shape)
    tangents_cam = tangents @ T[:3, :3].T * rng.choice([-1.0, 1.0], (len(points), 1))
    return (points_cam, tangents_cam) if keep is None else (points_cam[keep], tangents_cam[keep])


def wire_index(T: Floats, part: PartModel, rng: np.random.Generator) -> BoundaryIndex:
    """Return the index of a part's wires without noise."""
    return index_boundary(*wire_scene(T, part, rng), part.d_max)


def pose_of(part: PartModel, rotation: Floats) -> Floats:
    """Return (4, 4) with the part's centre on the optical axis."""
    return make_transform(rotation, np.array([0.0, 0.0, DISTANCE]) - rotation @ part.centre)


def random_pose(part: PartModel, rng: np.random.Generator) -> Floats:
    """Return any pose with the centre on the optical axis."""
    return pose_of(part, random_rotation(rng))


def beside(T: Floats, part: PartModel, rng: np.random.Generator, shift: float, turn: float) -> Floats:
    """Return a pose off by ``shift`` [m] and ``turn`` [rad] about the part's centre, in random directions."""
    direction = rng.normal(size=3)
    centre = T[:3, :3] @ part.centre + T[:3, 3]
    rotation = rotation_about(rng.normal(size=3), turn)
    moved = centre - rotation @ centre + shift * direction / np.linalg.norm(direction)
    return make_transform(rotation, moved) @ T


def look_at(*meshes_cam: trimesh.Trimesh, noise: float = 0.0) -> Frame:
    """Return the depth image of meshes in the camera frame over the floor."""
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays = np.column_stack([(u.ravel() - K[0, 2]) / K[0, 0], (v.ravel() - K[1, 2]) / K[1, 1], np.ones(u.size)])
    depth = np.full(u.size, FLOOR)
    if meshes_cam:
        mesh = trimesh.util.concatenate(list(meshes_cam))
        places, index, _ = mesh.ray.intersects_location(np.zeros_like(rays), rays, multiple_hits=False)
        depth[index] = places[:, 2]
    depth += noise * np.random.default_rng(0).normal(size=len(depth))
    return framed(depth.reshape(SIZE[1], SIZE[0]).astype(np.float32))


def framed(depth: NDArray[np.float32]) -> Frame:
    """Return a frame of a depth image (H, W)."""
    return Frame(grey=np.zeros(depth.shape, np.uint8), depth=depth, K=K, T_world_cam=np.eye(4))


def placed(part: PartModel, T: Floats) -> trimesh.Trimesh:
    """Return a part's mesh in the camera frame."""
    return part.mesh.copy().apply_transform(T)


def scattered(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return boundary points all over a small space, with any tangents, some of them 0."""
    points = rng.uniform((-0.05, -0.05, 0.4), (0.05, 0.05, 0.6), (800, 3))
    tangents = rng.normal(size=points.shape)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    tangents[::7] = 0.0
    return points, tangents
