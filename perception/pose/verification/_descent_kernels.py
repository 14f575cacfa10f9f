"""Compiled Gauss-Newton iterations on SE(3); a step is too short to return to the interpreter after each one.

Poses are (4, 4) ``T_cam_part``. A motion (6,) is a rotation vector about the part's centre times ``arm``, and a
translation [m].
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.pose._transform_kernels import Ints, Singles, apply
from perception.pose.verification._matching_kernels import rematch_edges
from perception.pose.verification._refine_kernels import (
    line_equations,
    patch_equations,
    plane_equations,
    sight_equations,
)

MIN_MATCHES = 6  # one for each degree of freedom
SETTLED = 2e-3  # share of d_max; a refinement has converged if its last step is shorter


@njit(cache=True, nogil=True)
def gauss_newton_step(hessian: Floats, gradient: Floats, damping: float, observable: float) -> Floats:
    """Return the damped step (6,) along the observable eigenvectors of the (6, 6) Hessian, and 0 along the others."""
    values, vectors = np.linalg.eigh(hessian)
    motion = np.zeros(6)
    for k in range(6):
        if values[k] <= max(observable, 1e-12):  # rounding alone makes an unobservable one larger than 0
            continue
        # The component of the gradient along eigenvector k, divided by the damped eigenvalue.
        along = 0.0
        for i in range(6):
            along += vectors[i, k] * gradient[i]
        for i in range(6):
            motion[i] -= vectors[i, k] * along / (values[k] + damping)
    return motion


@njit(cache=True, nogil=True)
def moved(T: Floats, motion: Floats, pivot: Floats, arm: float) -> Floats:
    """Return a pose after a motion: a rotation about ``pivot`` (camera frame), then a translation."""
    a, b, c = motion[0] / arm, motion[1] / arm, motion[2] / arm
    square = a * a + b * b + c * c
    angle = np.sqrt(square)
    # Rodrigues' formula; both factors by their series where the angle is small.
    first = 1.0 - square / 6 if angle < 1e-4 else np.sin(angle) / angle
    second = 0.5 - square / 24 if angle < 1e-4 else (1.0 - np.cos(angle)) / square
    cross = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
    rotation = np.eye(3) + first * cross + second * (cross @ cross)
    # rotation @ R, and pivot + rotation @ (t - pivot) + translation.
    out = np.zeros((4, 4))
    out[3, 3] = 1.0
    for i in range(3):
        out[i, 3] = pivot[i] + motion[3 + i]
        for j in range(3):
            out[i, 3] += rotation[i, j] * (T[j, 3] - pivot[j])
            for k in range(3):
                out[i, k] += rotation[i, j] * T[j, k]
    return out


@njit(cache=True, nogil=True)
def descend_edges(
    T: Floats,
    points: Floats,
    tangents: Floats,
    boundary: Floats,
    boundary_tangents: Floats,
    starts: NDArray[np.int64],
    shape: tuple[int, int],
    origin: Floats,
    cell: float,
    gate: float,
    min_cosine: float,
    centre: Floats,
    d_max: float,
    iterations: int,
    damping: float,
    observable: float,
    still: float,
) -> tuple[Floats, int, bool, float, int]:
    """Minimise point-to-line distances.

    Returns:
        The pose; the number of steps; whether the last step was short; the sum of squares [m^2] and the number of the
        matches in this pose.
    """
    pivot, length = np.zeros(3), np.inf
    steps, settled = 0, False
    matches = np.full(len(points), -1, np.int64)
    while True:
        # Matches and normal equations in the present pose.
        rematch_edges(
            matches,
            T,
            points,
            tangents,
            boundary,
            boundary_tangents,
            starts,
            shape,
            origin,
            cell,
            gate,
            gate,
            min_cosine,
        )
        pivot[0], pivot[1], pivot[2] = apply(T, centre[0], centre[1], centre[2])
        hessian, gradient, total, count = line_equations(
            T, points, matches, boundary, boundary_tangents, pivot, d_max / 2
        )
        if settled or steps == iterations or count < MIN_MATCHES:
            break
        # One step; its length is that of the motion as a share of d_max.
        motion = gauss_newton_step(hessian / count, gradient / count, damping, observable)
        T = moved(T, motion, pivot, d_max / 2)
        length = np.sqrt(np.sum(motion**2)) / d_max
        steps += 1
        settled = length < still
    # Matches may alternate for ever between two samples of one edge, so that a step far below the gate is accepted.
    return T, steps, count >= MIN_MATCHES and length < SETTLED, total, count


@njit(cache=True, nogil=True)
def descend_surface(
    T: Floats,
    points: Floats,
    normals: Floats,
    visible: NDArray[np.bool_],
    depth: Singles,
    K: Floats,
    gate: float,
    min_cosine: float,
    reach: int,
    centre: Floats,
    d_max: float,
    iterations: int,
    damping: float,
    observable: float,
    still: float,
) -> tuple[Floats, int, bool, float, int]:
    """Minimise point-to-plane distances; the returned values are those of :func:`descend_edges`."""
    pivot, length = np.zeros(3), np.inf
    steps, settled = 0, False
    while True:
        # Matches and normal equations in the present pose.
        pivot[0], pivot[1], pivot[2] = apply(T, centre[0], centre[1], centre[2])
        hessian, gradient, total, count = plane_equations(
            T, points, normals, visible, depth, K, gate, min_cosine, reach, pivot, d_max / 2
        )
        if settled or steps == iterations or count < MIN_MATCHES:
            break
        # One step; its length is that of the motion as a share of d_max.
        motion = gauss_newton_step(hessian / count, gradient / count, damping, observable)
        T = moved(T, motion, pivot, d_max / 2)
        length = np.sqrt(np.sum(motion**2)) / d_max
        steps += 1
        settled = length < still
    return T, steps, count >= MIN_MATCHES and length < SETTLED, total, count


@njit(cache=True, nogil=True)
def joint_equations(
    matches: Ints,
    T: Floats,
    edge_points: Floats,
    edge_tangents: Floats,
    boundary: Floats,
    boundary_tangents: Floats,
    starts: NDArray[np.int64],
    shape: tuple[int, int],
    origin: Floats,
    cell: float,
    match_gate: float,
    min_edge_cosine: float,
    edge_gate: float,
    edge_weight: float,
    points: Floats,
    normals: Floats,
    visible: NDArray[np.bool_],
    depth: Singles,
    K: Floats,
    surface_gate: float,
    patch: int,
    centre: Floats,
    d_max: float,
) -> tuple[Floats, Floats, float, float, int]:
    """Match edges and surface in a pose.

    ``matches`` holds the index of each edge point's match in a pose near this one, or -1; it is changed in place.

    Returns:
        The normal equations (6, 6), (6,) of the weighted distances of edges in the image and those of patches of the
        depth; the sum of their squares without weights [m^2], the sum of the weights, and the number of matches.
    """
    rematch_edges(
        matches,
        T,
        edge_points,
        edge_tangents,
        boundary,
        boundary_tangents,
        starts,
        shape,
        origin,
        cell,
        match_gate,
        match_gate,
        min_edge_cosine,
    )
    pivot = np.zeros(3)
    pivot[0], pivot[1], pivot[2] = apply(T, centre[0], centre[1], centre[2])
    edge_hessian, edge_gradient, edge_total, edge_count = sight_equations(
        T, edge_points, matches, boundary, boundary_tangents, edge_gate, pivot, d_max / 2
    )
    hessian, gradient, total, count = patch_equations(
        T, points, normals, visible, depth, K, surface_gate, patch, pivot, d_max / 2
    )
    return (
        edge_weight * edge_hessian + hessian,
        edge_weight * edge_gradient + gradient,
        edge_total + total,
        edge_weight * edge_count + count,
        edge_count + count,
    )


@njit(cache=True, nogil=True)
def descend_jointly(
    T: Floats,
    seen: tuple[Any, ...],
    iterations: int,
    damping: float,
    observable: float,
    still: float,
) -> tuple[Floats, int, bool, float, int]:
    """Minimise the squares of the distances of edges in the image, weighted, and of patches of the depth image.

    ``seen`` holds the arguments of :func:`joint_equations` after the pose. The returned values are those of
    :func:`descend_edges`; the matches are those of both kinds.
    """
    centre, d_max = seen[-2], seen[-1]
    pivot, length = np.zeros(3), np.inf
    steps, settled = 0, False
    matches = np.full(len(seen[0]), -1, np.int64)
    while True:
        # Matches and normal equations in the present pose.
        hessian, gradient, total, weights, count = joint_equations(matches, T, *seen)
        if settled or steps == iterations or count < MIN_MATCHES:
            break
        # One step; its length is that of the motion as a share of d_max.
        motion = gauss_newton_step(hessian / weights, gradient / weights, damping, observable)
        pivot[0], pivot[1], pivot[2] = apply(T, centre[0], centre[1], centre[2])
        T = moved(T, motion, pivot, d_max / 2)
        length = np.sqrt(np.sum(motion**2)) / d_max
        steps += 1
        settled = length < still
    return T, steps, count >= MIN_MATCHES and length < SETTLED, total, count
