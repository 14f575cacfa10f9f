"""Compiled kernels of refinement and verification: arrays in, arrays out, no threads and no fast maths.

Images are (H, W), indexed [v, u]; depth is 0 where there is no measurement. Poses are (4, 4) ``T_cam_part``. M model
points are in the part frame and N boundary points in the camera frame. Normal equations are those of a motion of six
lengths [m]: a rotation vector about ``centre`` times ``arm``, and a translation.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import NEAR, Floats
from perception.pose._transform_kernels import Ints, Singles, apply, rotate

END_ON = 0.3  # sine of the angle between the line of sight and an edge up to which its place in the image says little


@njit(cache=True, nogil=True)
def _lever(row: Floats, x: float, y: float, z: float, a: float, b: float, c: float, centre: Floats, arm: float) -> None:
    """Write the row ``[(p - centre) / arm x n, n]`` of the Jacobian of a distance along the normal n = (a, b, c)."""
    rx, ry, rz = (x - centre[0]) / arm, (y - centre[1]) / arm, (z - centre[2]) / arm
    row[0], row[1], row[2] = ry * c - rz * b, rz * a - rx * c, rx * b - ry * a
    row[3], row[4], row[5] = a, b, c


@njit(cache=True, nogil=True)
def _add(hessian: Floats, gradient: Floats, row: Floats, residual: float, weight: float) -> None:
    """Add one weighted residual to the normal equations; of the Hessian only the lower triangle."""
    for i in range(6):
        gradient[i] += weight * row[i] * residual
        for j in range(i + 1):
            hessian[i, j] += weight * row[i] * row[j]


@njit(cache=True, nogil=True)
def whole(hessian: Floats) -> Floats:
    """Return a symmetric (6, 6) matrix, changed in place, whose lower triangle is given."""
    for i in range(6):
        for j in range(i):
            hessian[j, i] = hessian[i, j]
    return hessian


@njit(cache=True, nogil=True)
def line_equations(
    T: Floats, points: Floats, matches: Ints, boundary: Floats, boundary_tangents: Floats, centre: Floats, arm: float
) -> tuple[Floats, Floats, float, int]:
    """Return the normal equations (6, 6), (6,) of point-to-line distances, their sum of squares [m^2], and the count.

    The residual of a match is ``e = (I - t t^T)(R p + t - q)``, with the tangent t of the boundary point q. A motion
    moves the posed point p by ``rotation x (p - centre) / arm + translation``.
    """
    hessian, gradient = np.zeros((6, 6)), np.zeros(6)
    jacobian, residual, direction = np.zeros((3, 6)), np.zeros(3), np.zeros(3)
    total, count = 0.0, 0
    for m in range(len(points)):
        k = matches[m]
        if k < 0:
            continue
        # Offset from the matched boundary point, and the Jacobian [skew(p - centre)^T / arm, I] of the posed point.
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        residual[0], residual[1], residual[2] = x - boundary[k, 0], y - boundary[k, 1], z - boundary[k, 2]
        rx, ry, rz = (x - centre[0]) / arm, (y - centre[1]) / arm, (z - centre[2]) / arm
        jacobian[:] = 0.0
        jacobian[0, 1], jacobian[0, 2] = rz, -ry
        jacobian[1, 0], jacobian[1, 2] = -rz, rx
        jacobian[2, 0], jacobian[2, 1] = ry, -rx
        for i in range(3):
            jacobian[i, 3 + i] = 1.0
            direction[i] = boundary_tangents[k, i]
        # Project both onto the plane perpendicular to the tangent.
        along = direction[0] * residual[0] + direction[1] * residual[1] + direction[2] * residual[2]
        for i in range(3):
            residual[i] -= along * direction[i]
            total += residual[i] * residual[i]
        for j in range(6):
            along = direction[0] * jacobian[0, j] + direction[1] * jacobian[1, j] + direction[2] * jacobian[2, j]
            for i in range(3):
                jacobian[i, j] -= along * direction[i]
        # Add J^T e and J^T J.
        for i in range(6):
            for r in range(3):
                gradient[i] += jacobian[r, i] * residual[r]
                for j in range(i + 1):
                    hessian[i, j] += jacobian[r, i] * jacobian[r, j]
        count += 1
    return whole(hessian), gradient, total, count


@njit(cache=True, nogil=True)
def sight_equations(
    T: Floats,
    points: Floats,
    matches: Ints,
    boundary: Floats,
    boundary_tangents: Floats,
    gate: float,
    centre: Floats,
    arm: float,
) -> tuple[Floats, Floats, float, int]:
    """Return the normal equations (6, 6), (6,) of distances in the image, their sum of squares [m^2], and the count.

    The residual of a match is the distance of the posed point from the plane through the camera and the tangent of the
    boundary point: that of an edge in the image, at the point's depth. The boundary point's own depth has no influence.
    Distances e have Tukey's weight ``(1 - (e / gate)^2)^2``. Edges seen nearly end on are left out.
    """
    hessian, gradient, row = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    total, count = 0.0, 0
    for m in range(len(points)):
        k = matches[m]
        if k < 0:
            continue
        # The unit normal of the plane, q x t.
        qx, qy, qz = boundary[k, 0], boundary[k, 1], boundary[k, 2]
        tx, ty, tz = boundary_tangents[k, 0], boundary_tangents[k, 1], boundary_tangents[k, 2]
        a, b, c = qy * tz - qz * ty, qz * tx - qx * tz, qx * ty - qy * tx
        length = np.sqrt(a * a + b * b + c * c)
        if length < END_ON * np.sqrt(qx * qx + qy * qy + qz * qz):
            continue
        a, b, c = a / length, b / length, c / length
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        residual = a * x + b * y + c * z
        if abs(residual) >= gate:
            continue
        weight = (1.0 - (residual / gate) ** 2) ** 2
        _lever(row, x, y, z, a, b, c, centre, arm)
        _add(hessian, gradient, row, residual, weight)
        total += residual * residual
        count += 1
    return whole(hessian), gradient, total, count


@njit(cache=True, nogil=True)
def surface_gaps(
    T: Floats, points: Floats, normals: Floats, visible: NDArray[np.bool_], depth: Singles, K: Floats, radius: int
) -> Floats:
    """Return (M,) signed distances [m] of the measured surface behind (+) or before (-) the samples' tangent planes.

    Of the measured points in a window of ``radius`` pixels about a sample the one nearest to its plane counts, because
    an outline may be a pixel off. The distance is NaN where a sample is not visible, not before the camera or outside
    the image, or where nothing was measured.
    """
    height, width = depth.shape
    out = np.full(len(points), np.nan)
    for m in range(len(points)):
        if not visible[m]:
            continue
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        if z <= NEAR:
            continue
        a, b, c = rotate(T, normals[m, 0], normals[m, 1], normals[m, 2])
        # The sample's pixel, rounded by truncation of u + 1/2, and the window about it.
        u0, v0 = K[0, 0] * x / z + K[0, 2] + 0.5, K[1, 1] * y / z + K[1, 2] + 0.5
        if not (0 <= u0 < width and 0 <= v0 < height):
            continue
        top, bottom = max(int(v0) - radius, 0), min(int(v0) + radius, height - 1)
        left, right = max(int(u0) - radius, 0), min(int(u0) + radius, width - 1)
        # The measured point nearest to the sample's tangent plane.
        best = np.inf
        for v in range(top, bottom + 1):
            for u in range(left, right + 1):
                zq = float(depth[v, u])
                if zq <= 0.0:
                    continue
                xq, yq = zq * (u - K[0, 2]) / K[0, 0], zq * (v - K[1, 2]) / K[1, 1]
                gap = a * (x - xq) + b * (y - yq) + c * (z - zq)
                if abs(gap) < abs(best):
                    best = gap
        if best < np.inf:
            out[m] = best
    return out


@njit(cache=True, nogil=True)
def measured_normal(depth: Singles, K: Floats, u: int, v: int, reach: int) -> tuple[float, float, float]:
    """Return the normal towards the camera of the measured surface at a pixel, by central differences.

    It is (0, 0, 0) where one of the four pixels ``reach`` away is outside the image or without depth.
    """
    height, width = depth.shape
    if u < reach or v < reach or u >= width - reach or v >= height - reach:
        return 0.0, 0.0, 0.0
    west, east = float(depth[v, u - reach]), float(depth[v, u + reach])
    north, south = float(depth[v - reach, u]), float(depth[v + reach, u])
    if west <= 0 or east <= 0 or north <= 0 or south <= 0:
        return 0.0, 0.0, 0.0
    # a is the difference of the points to the east and the west, b that of the points to the south and the north.
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    du, dv = reach / K[0, 0], reach / K[1, 1]
    ax, ay, az = east * (x + du) - west * (x - du), (east - west) * y, east - west
    bx, by, bz = (south - north) * x, south * (y + dv) - north * (y - dv), south - north
    # b x a points towards the camera.
    nx, ny, nz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length


@njit(cache=True, nogil=True)
def plane_equations(
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
    arm: float,
) -> tuple[Floats, Floats, float, int]:
    """Return the normal equations (6, 6), (6,) of point-to-plane distances, their sum of squares [m^2], and the count.

    A sample is matched with the measured point of the pixel it projects to, if their normals agree and the distance
    along the sample's own normal is less than ``gate`` [m]. Distances e have Tukey's weight ``(1 - (e / gate)^2)^2``.
    """
    height, width = depth.shape
    hessian, gradient, row = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    total, count = 0.0, 0
    for m in range(len(points)):
        if not visible[m]:
            continue
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        if z <= NEAR:
            continue
        # The measured point of the pixel that the sample projects to.
        uf, vf = K[0, 0] * x / z + K[0, 2] + 0.5, K[1, 1] * y / z + K[1, 2] + 0.5
        if not (0 <= uf < width and 0 <= vf < height):
            continue
        u, v = int(uf), int(vf)
        zq = float(depth[v, u])
        if zq <= 0.0:
            continue
        # The residual along the sample's normal, rejected by distance or by the measured normal.
        a, b, c = rotate(T, normals[m, 0], normals[m, 1], normals[m, 2])
        xq, yq = zq * (u - K[0, 2]) / K[0, 0], zq * (v - K[1, 2]) / K[1, 1]
        residual = a * (x - xq) + b * (y - yq) + c * (z - zq)
        if abs(residual) >= gate:
            continue
        nx, ny, nz = measured_normal(depth, K, u, v, reach)
        if a * nx + b * ny + c * nz < min_cosine:
            continue
        weight = (1.0 - (residual / gate) ** 2) ** 2
        _lever(row, x, y, z, a, b, c, centre, arm)
        _add(hessian, gradient, row, residual, weight)
        total += residual * residual
        count += 1
    return whole(hessian), gradient, total, count


@njit(cache=True, nogil=True)
def patch_equations(
    T: Floats,
    points: Floats,
    normals: Floats,
    visible: NDArray[np.bool_],
    depth: Singles,
    K: Floats,
    gate: float,
    radius: int,
    centre: Floats,
    arm: float,
) -> tuple[Floats, Floats, float, int]:
    """Return the normal equations (6, 6), (6,) of distances of patches, their sum of squares [m^2], and the count.

    A sample's residual is the mean distance of the points measured within ``radius`` pixels of it from its tangent
    plane, with Tukey's weight ``(1 - (e / gate)^2)^2``. It matches if at least half of them are within ``gate`` [m].
    """
    height, width = depth.shape
    hessian, gradient, row = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    across, down = np.zeros(2 * radius + 1), np.zeros(2 * radius + 1)
    total, count, window = 0.0, 0, (2 * radius + 1) ** 2
    for m in range(len(points)):
        if not visible[m]:
            continue
        x, y, z = apply(T, points[m, 0], points[m, 1], points[m, 2])
        if z <= NEAR:
            continue
        uf, vf = K[0, 0] * x / z + K[0, 2] + 0.5, K[1, 1] * y / z + K[1, 2] + 0.5
        if not (radius <= uf < width - radius and radius <= vf < height - radius):
            continue
        a, b, c = rotate(T, normals[m, 0], normals[m, 1], normals[m, 2])
        along = a * x + b * y + c * z
        # The normal times the direction of each pixel's line of sight, column by column and row by row.
        left, top = int(uf) - radius, int(vf) - radius
        for k in range(2 * radius + 1):
            across[k] = a * (left + k - K[0, 2]) / K[0, 0]
            down[k] = b * (top + k - K[1, 2]) / K[1, 1]
        weights, mean, near = 0.0, 0.0, 0
        for i in range(2 * radius + 1):
            for j in range(2 * radius + 1):
                zq = float(depth[top + i, left + j])
                if zq <= 0.0:
                    continue
                residual = along - zq * (across[j] + down[i] + c)
                if abs(residual) < gate:
                    weight = (1.0 - (residual / gate) ** 2) ** 2
                    weights += weight
                    mean += weight * residual
                    near += 1
        if 2 * near < window:
            continue
        mean /= weights
        _lever(row, x, y, z, a, b, c, centre, arm)
        _add(hessian, gradient, row, mean, weights / window)
        total += mean * mean
        count += 1
    return whole(hessian), gradient, total, count
