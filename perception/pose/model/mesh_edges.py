"""The edges of a mesh that a camera sees: creases, silhouettes and depth jumps, sampled on the mesh itself.

In the image of a polyhedron every discontinuity of depth lies on a mesh edge between a face that is turned to the
camera and one that is not, and every step of the normal lies on a mesh edge, too. So no image is rendered. Such edges
are sampled, and rays decide which samples are visible and what lies behind them. Points and tangents are exact.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.geometry import Floats
from perception.pose.model._edge_kernels import bounding, chains, cross_products, facing, scatter

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

EDGE_ON = 1e-4  # cosine below which a face counts as turned away, so that an edge-on face is never ambiguous
LIFT = 1e-4  # share of d_max; distance of a ray's origin from the surface, far above Embree's precision (1e-7)
ASIDE = 0.004  # share of d_max; distance beside an edge of the ray to what lies behind it, a pixel of a close view
BULGE = 0.25  # share of d_max; a surface inside a silhouette that is nearer by more belongs to another feature
STRAIGHT = 0.9  # linearity below which a chain has a corner, so that its edges keep their own tangents


@dataclass(frozen=True, eq=False, kw_only=True)
class EdgeSamples:
    """Points on the mesh edges where the surface bends.

    Attributes:
        points: (S, 3) sampled points, part frame [m].
        tangents: (S, 3) unit directions of the edges.
        faces: (S, 2) indices of the two faces that meet at each edge.
        opposite: (S, 2, 3) corner of each of these faces that is not on the edge, part frame [m].
        outward: (S, 3) unit mean of the normals of both faces.
        ends: (S, 2) indices of the vertices of each edge.
        length: (S,) length of each edge [m].
        crease: (S,) whether the normals of both faces differ by more than the crease angle.
    """

    points: Floats
    tangents: Floats
    faces: Ints
    opposite: Floats
    outward: Floats
    ends: Ints
    length: Floats
    crease: Bools


@dataclass(frozen=True, kw_only=True)
class EdgeLimits:
    """Definition of an edge in absolute units.

    Attributes:
        crease: Angle between two normals above which shading shows an edge [rad].
        depth_jump: Step in depth that is an edge [m].
        diameter: Diameter of the part [m].
    """

    crease: float
    depth_jump: float
    diameter: float


def sample_edges(mesh: trimesh.Trimesh, crease: float, step: float) -> EdgeSamples:
    """Sample every mesh edge at the middles of equal pieces of at most ``step`` [m]; flat seams are left out."""
    bent = mesh.face_adjacency_angles > 1e-6
    ends = np.asarray(mesh.face_adjacency_edges[bent], dtype=np.int64)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    start, stop = vertices[ends[:, 0]], vertices[ends[:, 1]]
    length = np.linalg.norm(stop - start, axis=1)
    pieces = np.maximum(np.ceil(length / step - 1e-9), 1).astype(np.int64)
    edge = np.repeat(np.arange(len(ends)), pieces)
    within = np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    share = ((within + 0.5) / pieces[edge])[:, None]
    faces = np.asarray(mesh.face_adjacency[bent], dtype=np.int64)
    outward = mesh.face_normals[faces].sum(axis=1)
    return EdgeSamples(
        points=(1 - share) * start[edge] + share * stop[edge],
        tangents=_unit(stop - start)[edge],
        faces=faces[edge],
        opposite=vertices[mesh.face_adjacency_unshared[bent]][edge],
        outward=_unit(outward)[edge],
        ends=ends[edge],
        length=length[edge],
        crease=(mesh.face_adjacency_angles[bent] > crease + 1e-6)[edge],
    )


def seen_edges(mesh: trimesh.Trimesh, samples: EdgeSamples, eye: Floats, limits: EdgeLimits) -> Ints:
    """Return the ascending indices of the samples that are edges in the view from ``eye``.

    A crease is an edge where both faces are turned to the camera. Where only one face is, the surface ends in the
    image. There must then be nothing beside it, or a surface that is farther by a depth jump, or a surface behind it
    that differs by the crease angle.

    Args:
        mesh: Mesh of the part; rays are cast by trimesh with Embree.
        samples: Samples of the edges of the same mesh.
        eye: (4,) homogeneous position of the camera, part frame [m]; the last entry is 0 for a parallel view.
        limits: Definition of an edge.
    """
    facing_eye = _facing(mesh, eye)
    chosen = bounding(facing_eye, samples.faces, samples.crease)
    towards = towards_eye(samples.points[chosen], eye)
    lifted = samples.points[chosen] + LIFT * limits.diameter * samples.outward[chosen]
    free = ~_blocked(mesh, lifted, towards)
    chosen, towards = chosen[free], towards[free]
    front = facing_eye[samples.faces[chosen]]
    ending = front[:, 0] != front[:, 1]
    near = front[ending, 1].astype(np.int64)
    kept = ~ending
    kept[ending] = _stands_out(mesh, samples, chosen[ending], near, towards[ending], limits)
    seen: Ints = chosen[kept]
    return seen


def towards_eye(points: Floats, eye: Floats) -> Floats:
    """Return the (N, 3) unit directions from (N, 3) points to a homogeneous (4,) position of the camera."""
    return _unit(eye[:3] - eye[3] * points)


def inset_points(
    mesh: trimesh.Trimesh, samples: EdgeSamples, chosen: Ints, eye: Floats, inset: float, diameter: float
) -> Floats:
    """Return the (C, 3) points of the surface that an image shows ``inset`` [m] inside curved silhouettes.

    The point on the silhouette itself is kept where the ray meets no surface or one that is not the curved surface.

    Args:
        mesh: Mesh of the part.
        samples: Samples of the edges of the same mesh.
        chosen: (C,) indices of the samples on curved silhouettes.
        eye: (4,) homogeneous position of the camera, part frame [m]; the last entry is 0 for a parallel view.
        inset: Distance from the silhouette in the image [m].
        diameter: Diameter of the part [m].
    """
    points = samples.points[chosen].copy()
    if inset == 0 or len(chosen) == 0:
        return points
    towards = towards_eye(points, eye)
    aside = _unit(cross_products(samples.tangents[chosen], towards))
    outwards = np.sign(np.einsum("ci,ci->c", aside, samples.outward[chosen]))[:, None] * aside
    origins = points - inset * outwards + 2 * diameter * towards
    hits, ray, _ = mesh.ray.intersects_location(origins, -towards, multiple_hits=False)
    nearer = np.einsum("ci,ci->c", hits - points[ray], towards[ray])
    same = (nearer > 0) & (nearer < BULGE * diameter)
    points[ray[same]] = hits[same]
    return points


def chain_tangents(samples: EdgeSamples, chosen: Ints, radius: float) -> Floats:
    """Return the (C, 3) tangents of chosen samples; those of short edges are fitted to the chain they belong to.

    The silhouette of a finely meshed curved surface zigzags along mesh edges. Its tangent is the first principal axis
    of the samples within ``radius`` [m] on the same chain, unless these turn a corner.
    """
    tangents = samples.tangents[chosen].copy()
    short = np.nonzero(samples.length[chosen] < radius)[0]
    if len(short) == 0:
        return tangents
    points, chain = samples.points[chosen[short]], chains(samples.ends[chosen[short]])
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    values, axes = np.linalg.eigh(scatter(points, pairs, chain))
    straight = values[:, 2] - values[:, 1] > STRAIGHT * values[:, 2]
    tangents[short[straight]] = axes[straight, :, 2]
    return tangents


def _facing(mesh: trimesh.Trimesh, eye: Floats) -> Bools:
    """Return (F,) whether each face is turned to the camera."""
    # The height of the camera over a face's plane is the same for all triangles of the plane, so they always agree.
    reach = float(np.linalg.norm(eye[:3] - eye[3] * mesh.bounds.mean(axis=0)))
    turned: Bools = facing(mesh.face_normals, mesh.triangles[:, 0], eye, EDGE_ON * reach)
    return turned


def _blocked(mesh: trimesh.Trimesh, origins: Floats, directions: Floats) -> Bools:
    """Return (R,) whether each ray meets the mesh."""
    if len(origins) == 0:
        return np.zeros(0, dtype=np.bool_)
    hit: Bools = mesh.ray.intersects_first(origins, directions) >= 0
    return hit


def _stands_out(
    mesh: trimesh.Trimesh, samples: EdgeSamples, chosen: Ints, near: Ints, towards: Floats, limits: EdgeLimits
) -> Bools:
    """Return (C,) whether the image changes across each edge of which only the face ``near`` is visible."""
    if len(chosen) == 0:
        return np.zeros(0, dtype=np.bool_)
    points, rows = samples.points[chosen], np.arange(len(chosen))
    aside = _unit(cross_products(samples.tangents[chosen], towards))
    inward = np.einsum("ci,ci->c", aside, samples.opposite[chosen, near] - points)
    beside = points - (np.sign(inward) * ASIDE * limits.diameter)[:, None] * aside
    back = 2 * limits.diameter
    hits, ray, face = mesh.ray.intersects_location(beside + back * towards, -towards, multiple_hits=False)
    drop, turn = np.full(len(rows), np.inf), np.zeros(len(rows))
    drop[ray] = np.einsum("ci,ci->c", points[ray] - hits, towards[ray])
    normals = mesh.face_normals[samples.faces[chosen, near]]
    turn[ray] = np.arccos(np.clip(np.einsum("ci,ci->c", normals[ray], mesh.face_normals[face]), -1, 1))
    stands_out: Bools = (drop > limits.depth_jump) | ((turn > limits.crease) & (drop > -ASIDE * limits.diameter))
    return stands_out


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Floats = vectors / np.where(length > 0, length, 1.0)
    return unit
