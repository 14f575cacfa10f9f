"""Antipodal grasps of a parallel jaw on a mesh: where two opposite faces meet the pads, and how well.

All poses are in the part frame. The grasp frame is the one of :class:`policies.grasping.outcomes.Grasp`.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from perception.geometry import Floats
from policies.grasping._kernels import clear_of_solid, fill_solid
from policies.grasping.gripper import PAD_SIZE, GripperModel

_GRID = (6, 9)  # rays across and along a pad, on a part that is not thin
_TOUCH = 1e-3  # depth behind the first contact within which a surface touches the pad: rubber, and tilt [m]
_START = 6e-3  # distance from the faces at which closing begins [m]


@dataclass(frozen=True, eq=False, kw_only=True)
class Solid:
    """Signed distance to a mesh on a grid, negative inside, accurate to half a voxel; all beyond the grid is clear.

    Attributes:
        field: (X, Y, Z) signed distance at the voxels' centres [m].
        origin: (3,) centre of voxel (0, 0, 0), part frame [m].
        voxel: Edge length of a voxel [m].
    """

    field: Floats
    origin: Floats
    voxel: float

    @classmethod
    def from_mesh(cls, mesh: trimesh.Trimesh, *, voxel: float = 0.8e-3, border: float = 8e-3) -> "Solid":
        """Measure a watertight mesh [m] on a grid larger by ``border`` [m] all around, a large one in larger voxels."""
        voxel = max(voxel, float(mesh.extents.max()) / 160)
        # The odd shift keeps the columns off the edges of faces that lie on round coordinates.
        origin = mesh.bounds[0] - border - voxel * np.array([0.217, 0.381, 0.143])
        shape = np.ceil((mesh.extents + 2 * border) / voxel).astype(int) + 1
        occupied = np.zeros(shape, dtype=np.bool_)
        fill_solid(np.ascontiguousarray(mesh.triangles, dtype=np.float64), origin, voxel, occupied)
        outside, inside = distance_transform_edt(~occupied), distance_transform_edt(occupied)
        field = np.where(occupied, 0.5 - inside, outside - 0.5) * voxel
        return cls(field=field, origin=origin, voxel=voxel)

    def distance(self, points_part: Floats) -> Floats:
        """Return the (N,) signed distance [m] of the voxel at each of (N, 3) points, infinite beyond the grid."""
        cells = np.rint((points_part - self.origin) / self.voxel).astype(int)
        inside = np.all((cells >= 0) & (cells < self.field.shape), axis=1)
        i, j, k = np.where(inside[:, None], cells, 0).T
        return np.where(inside, self.field[i, j, k], np.inf)

    def clear(
        self,
        T_part_tcp: Floats,
        gap: Floats,
        gripper: GripperModel,
        *,
        margin: float,
        pad_margin: float,
        retreat: float = 0.0,
    ) -> NDArray[np.bool_]:
        """Return the (N,) mask of poses at which every point of the gripper keeps its distance from the part.

        Args:
            T_part_tcp: (N, 4, 4) poses.
            gap: (N,) distance between the pads [m].
            gripper: Points on the gripper's surfaces.
            margin: Distance that all points but the pads' keep [m].
            pad_margin: Distance that the pads' points keep [m]; negative while they press on the part.
            retreat: Distance of the gripper back along the approach [m].
        """
        tables = gripper.gaps, gripper.points, gripper.pad
        field = self.field, self.origin, self.voxel
        clear: NDArray[np.bool_] = clear_of_solid(*field, T_part_tcp, gap, retreat, *tables, margin, pad_margin)
        return clear


def opposite_faces(
    mesh: trimesh.Trimesh, count: int, min_cosine: float, widths: tuple[float, float], seed: int
) -> tuple[Floats, Floats]:
    """Draw surface points and cast rays through the part to every opposite face on the far side.

    Args:
        mesh: Watertight mesh [m].
        count: Number of points, drawn by area.
        min_cosine: Least cosine of the angle between each face's normal and the line: the friction cone.
        widths: Least and largest distance between the faces [m].
        seed: Seed of the draw.

    Returns:
        (M, 3) points and (M, 3) opposite points [m]. A tube's outer walls pair up across the bore. On faces that are
        not parallel, the line makes the same angle with both normals.
    """
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=seed)
    inward = -mesh.face_normals[faces]
    # First along the inward normal, where the opposite face may lean by two cones; then along the mean of both normals.
    ray, _, outward = _exits(mesh, points, inward, 2 * min_cosine**2 - 1)
    line = inward[ray] + outward
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    within = np.einsum("ni,ni->n", inward[ray], line) >= min_cosine
    start, line = points[ray[within]], line[within]
    # A ray that leaves through several parallel faces has come back once for each of them.
    once = np.unique(np.round(np.column_stack([start, line]), 6), axis=0, return_index=True)[1]
    start, line = start[once], line[once]
    ray, hits, _ = _exits(mesh, start, line, min_cosine)
    distance = np.linalg.norm(hits - start[ray], axis=1)
    keep = (distance >= widths[0]) & (distance <= widths[1])
    return start[ray[keep]], hits[keep]


def _exits(
    mesh: trimesh.Trimesh, points: Floats, line: Floats, min_cosine: float
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return where rays leave the part, by ray and distance: (M,) rays, (M, 3) points and (M, 3) outward normals."""
    hits, ray, face = mesh.ray.intersects_location(points + 1e-5 * line, line, multiple_hits=True)
    normal = mesh.face_normals[face]
    keep = np.einsum("ni,ni->n", normal, line[ray]) >= min_cosine
    hits, ray, normal = hits[keep], ray[keep], normal[keep]
    order = np.lexsort((np.linalg.norm(hits - points[ray], axis=1), ray))
    return ray[order], hits[order], normal[order]


def grasps_on_lines(first: Floats, second: Floats, turns: int, depths: tuple[float, ...]) -> tuple[Floats, Floats]:
    """Return (N, 4, 4) grasps and (N,) widths [m] on lines through the part, given by (M, 3) end points.

    There is one for each line, each of ``turns`` approaches about it, and each depth [m] of the fingertips behind it.
    The first approach is along the part axis most perpendicular to the line, so that the part's own axes are met.
    """
    line = second - first
    widths = np.linalg.norm(line, axis=1)
    y = line / widths[:, None]
    across = np.eye(3)[np.argmin(np.abs(y), axis=1)]
    u = across - np.sum(across * y, axis=1, keepdims=True) * y
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(y, u)
    angles = 2 * np.pi * np.arange(turns) / turns
    z = np.cos(angles)[:, None] * u[:, None] + np.sin(angles)[:, None] * v[:, None]  # (M, turns, 3)
    z = np.repeat(z[:, :, None], len(depths), axis=2).reshape(-1, 3)
    repeat = turns * len(depths)
    y = np.repeat(y, repeat, axis=0)
    T = np.zeros((len(z), 4, 4))
    T[:, :3, 0], T[:, :3, 1], T[:, :3, 2] = np.cross(y, z), y, z
    T[:, :3, 3] = np.repeat((first + second) / 2, repeat, axis=0) + np.tile(depths, len(first) * turns)[:, None] * z
    T[:, 3, 3] = 1.0
    return T, np.repeat(widths, repeat)


@dataclass(frozen=True, eq=False, kw_only=True)
class Contacts:
    """How two closing pads meet a part, per grasp (N,).

    Attributes:
        shift: Position of the middle between the closed pads along the grasp's y [m].
        width: Distance between the pads at contact [m]; -inf where a pad meets nothing.
        area: Area of the smaller contact patch as a share of a pad's face.
        alignment: Cosine between mean normal and closing direction, at the patch where it is smaller.
        offset: Distance between the patches' centres in the pads' plane [m], reduced by the share that lies opposite.
        middle: (N, 2) x and z of the mean of both patches' centres, grasp frame [m].
    """

    shift: Floats
    width: Floats
    area: Floats
    alignment: Floats
    offset: Floats
    middle: Floats


def close_pads(mesh: trimesh.Trimesh, T_part_grasp: Floats, widths: Floats, scale: float = 1.0) -> Contacts:
    """Close both pads on (N, 4, 4) grasps from just outside of (N,) ``widths`` [m] until each first touches the part.

    Args:
        mesh: Watertight mesh [m].
        T_part_grasp: (N, 4, 4) grasps.
        widths: (N,) distances between the faces that the lines of the grasps meet [m].
        scale: Spacing of the rays as a share of 4 mm.

    Note:
        108 rays a grasp, about 0.1 ms, at scale 1. Features narrower than the rays' spacing can slip through.
    """
    across, along = (int(np.ceil(count / scale)) for count in _GRID)
    x = (np.arange(across) + 0.5) / across * PAD_SIZE[0] - PAD_SIZE[0] / 2
    z = (np.arange(along) + 0.5) / along * PAD_SIZE[2] - PAD_SIZE[2]
    grid = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)
    sides = [_first_touch(mesh, T_part_grasp, widths, grid, side) for side in (1.0, -1.0)]
    (reach_p, normal_p), (reach_n, normal_n) = sides  # along +y and along -y from the grasp's origin
    top, bottom = reach_p.max(axis=1), reach_n.max(axis=1)
    touch = [reach_p >= top[:, None] - _TOUCH, reach_n >= bottom[:, None] - _TOUCH]
    touch = [t & np.isfinite(r) for t, r in zip(touch, (reach_p, reach_n), strict=True)]
    cells = [np.maximum(t.sum(axis=1), 1) for t in touch]
    y = T_part_grasp[:, :3, 1]
    leans = (_alignment(touch[0], normal_p, y), _alignment(touch[1], normal_n, -y))
    centres = [(t @ grid) / n[:, None] for t, n in zip(touch, cells, strict=True)]
    opposed = (touch[0] & touch[1]).sum(axis=1) / np.minimum(*cells)
    offset = np.linalg.norm(centres[0] - centres[1], axis=1)
    with np.errstate(invalid="ignore"):  # -inf - -inf where neither pad meets anything
        shift = np.where(np.isfinite(top + bottom), (top - bottom) / 2, 0.0)
    return Contacts(
        shift=shift,
        width=top + bottom,
        area=np.minimum(touch[0].sum(axis=1), touch[1].sum(axis=1)) / len(grid),
        alignment=np.minimum(*leans),
        offset=offset * (1 - opposed),
        middle=(centres[0] + centres[1]) / 2,
    )


def _alignment(touch: NDArray[np.bool_], normals: Floats, outward: Floats) -> Floats:
    """Return (N,) cosines between ``outward`` (N, 3) and the mean of (N, R, 3) normals where (N, R) ``touch``.

    It takes the mean normal, not the mean cosine, so that a cylinder gripped across its axis has an alignment of 1.
    """
    mean = np.einsum("nr,nri->ni", touch.astype(np.float64), normals)
    length = np.linalg.norm(mean, axis=1)
    cosine: Floats = np.einsum("ni,ni->n", mean, outward) / np.where(length > 0, length, 1.0)
    return cosine


def _first_touch(
    mesh: trimesh.Trimesh, T_part_grasp: Floats, widths: Floats, grid: Floats, side: float
) -> tuple[Floats, Floats]:
    """Cast rays from the pad on ``side`` (+1 or -1) of y towards the middle.

    Returns:
        (N, R) distance of the hit surface from the grasp's origin towards that side [m], -inf where nothing is met, and
        the (N, R, 3) normals there, part frame.
    """
    R, origin = T_part_grasp[:, :3, :3], T_part_grasp[:, :3, 3]
    start = widths / 2 + _START
    local = np.zeros((len(widths), len(grid), 3))
    local[..., 0], local[..., 2] = grid[:, 0], grid[:, 1]
    local[..., 1] = side * start[:, None]
    rays = np.einsum("nij,nrj->nri", R, local) + origin[:, None]
    outward = np.repeat(side * R[:, :, 1], len(grid), axis=0)
    flat = rays.reshape(-1, 3)
    face = mesh.ray.intersects_first(flat, -outward)
    normal = mesh.face_normals[face]  # a ray without a hit gets the last face, which is masked below
    cosine = np.einsum("ni,ni->n", normal, outward)
    with np.errstate(divide="ignore", invalid="ignore"):
        travel = np.einsum("ni,ni->n", normal, flat - mesh.triangles[face, 0]) / cosine
    travel = np.where((face >= 0) & (cosine > 1e-6), travel, np.inf).reshape(len(widths), len(grid))
    reach = start[:, None] - travel
    return reach, normal.reshape(rays.shape)
