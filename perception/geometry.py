"""Rigid transforms, unit quaternions and the pinhole camera.

Conventions, here and everywhere: ``T_a_b`` is (4, 4) float64 and maps b-coordinates to a-coordinates, quaternions are
wxyz and unit, the camera frame is OpenCV's (x right, y down, z forward), lengths are metres and angles radians.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
NEAR = 1e-3  # smallest depth of a point that is projected or drawn [m]
_FIELDS_OF_VIEW = 0.5, 170.0  # angles that an image's width or height can show [deg]
_SKEW = 0.01  # largest skew that is taken for a rounding error [px]
_OFF_AXIS = 80.0  # largest angle between the optical axis and any side of an image of a pinhole camera [deg]
_RIGID = 1e-3  # largest deviation of R^T R from the identity: a pose written with three decimals is still rigid


def require_kind(name: str, value: object, kind: type, advice: str = "") -> None:
    """Check that an argument is what a function works with.

    Args:
        name: Name of the argument.
        value: The argument.
        kind: Class that it must be of.
        advice: What to do, after the message.

    Raises:
        ValueError: It is of another class.
    """
    if not isinstance(value, kind):
        raise ValueError(f"{name} must be a {kind.__name__}, got {repr(value)[:60]}{advice and f': {advice}'}")


def require_shape(name: str, array: NDArray[np.generic], shape: tuple[int | None, ...]) -> None:
    """Raise ``ValueError`` unless ``array`` has ``shape``; ``None`` stands for any length."""
    if array.shape == shape:
        return
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("N" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "")
        raise ValueError(f"{name} must be ({wanted}), got {array.shape}")


def as_floats(name: str, values: ArrayLike) -> Floats:
    """Return numbers, also those of a list or a tuple, as a float64 array; one of these is returned as it is.

    Raises:
        ValueError: They are no numbers.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be an array of numbers, got {values!r}") from None


def require_rigid(name: str, T_a_b: Floats) -> None:
    """Raise ``ValueError`` unless a (4, 4) transform is finite, and a rotation and a translation.

    A calibration that solved for all twelve values freely, a scale, or axes of the other handedness are not rigid.
    """
    require_shape(name, T_a_b, (4, 4))
    if not np.all(np.isfinite(T_a_b)):
        raise ValueError(f"{name} must be finite")
    R = np.asarray(T_a_b, np.float64)[:3, :3]
    if not np.allclose(T_a_b[3], [0.0, 0.0, 0.0, 1.0], rtol=0, atol=1e-9):
        advice = " (is it transposed?)" if not np.allclose(T_a_b[3, :3], 0.0) else ""
        raise ValueError(f"the last row of {name} must be [0, 0, 0, 1], got {np.asarray(T_a_b)[3].tolist()}{advice}")
    deviation = float(np.abs(R.T @ R - np.eye(3)).max())
    if deviation > _RIGID:
        raise ValueError(
            f"{name} must be rigid, a rotation and a translation, but R^T R differs from the identity by "
            f"{deviation:.3g}: remove its scale and shear"
        )
    if np.linalg.det(R) < 0:
        raise ValueError(
            f"{name} must be right-handed, but its rotation has the determinant -1: it mirrors. Turn an axis into the "
            "cross product of the other two, or ask for the right-handed axes of the source"
        )


def make_transform(rotation: ArrayLike | None = None, translation: ArrayLike | None = None) -> Floats:
    """Return the (4, 4) transform of a (3, 3) rotation and a (3,) translation [m]; either may be left out."""
    T = np.eye(4)
    if rotation is not None:
        T[:3, :3] = rotation
    if translation is not None:
        T[:3, 3] = translation
    return T


def invert_transform(T_a_b: Floats) -> Floats:
    """Return the inverses ``T_b_a`` of (..., 4, 4) transforms."""
    R_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    T_b_a = np.zeros_like(T_a_b)
    T_b_a[..., :3, :3] = R_b_a
    T_b_a[..., :3, 3] = -np.einsum("...ij,...j->...i", R_b_a, T_a_b[..., :3, 3])
    T_b_a[..., 3, 3] = 1.0
    return T_b_a


def transform_points(T_a_b: Floats, points_b: Floats) -> Floats:
    """Map (N, 3) points from frame b to frame a."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def transform_point_each(T_a_b: Floats, point_b: Floats) -> Floats:
    """Map one (3,) point by each of (N, 4, 4) transforms to (N, 3)."""
    points: Floats = T_a_b[:, :3, :3] @ point_b + T_a_b[:, :3, 3]
    return points


def matrix_from_quat(quat: ArrayLike) -> Floats:
    """Return the (..., 3, 3) rotation of (..., 4) wxyz quaternions."""
    return Rotation.from_quat(np.asarray(quat, dtype=np.float64), scalar_first=True).as_matrix()


def quat_from_matrix(rotation: ArrayLike) -> Floats:
    """Return the (..., 4) wxyz quaternion with w >= 0 of (..., 3, 3) rotations."""
    return Rotation.from_matrix(np.asarray(rotation, dtype=np.float64)).as_quat(canonical=True, scalar_first=True)


def rotation_about(axis: ArrayLike, angle: float) -> Floats:
    """Return the (3, 3) rotation by ``angle`` [rad] about ``axis``, a (3,) vector of any length but 0."""
    axis = np.asarray(axis, dtype=np.float64)
    return Rotation.from_rotvec(axis * (angle / np.linalg.norm(axis))).as_matrix()


def rotation_angle(rotation: Floats) -> Floats:
    """Return the angle [rad] in [0, pi] of (..., 3, 3) rotations."""
    # atan2 of the skew part and the trace keeps its precision at 0 and pi, where acos of the trace loses half of it.
    skew = rotation - np.swapaxes(rotation, -1, -2)
    sine = 0.5 * np.sqrt(skew[..., 2, 1] ** 2 + skew[..., 0, 2] ** 2 + skew[..., 1, 0] ** 2)
    angle: Floats = np.arctan2(sine, 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0))
    return angle


def rotation_6d(rotation: Floats) -> Floats:
    """Return the (..., 6) continuous encoding of (..., 3, 3) rotations: the first two columns, one after the other.

    Source: Zhou et al., "On the Continuity of Rotation Representations in Neural Networks", CVPR 2019.
    """
    return np.concatenate([rotation[..., :, 0], rotation[..., :, 1]], axis=-1)


def rotation_from_6d(encoding: Floats) -> Floats:
    """Return the (..., 3, 3) rotations of (..., 6) encodings by Gram-Schmidt, the inverse of :func:`rotation_6d`.

    The two halves of an encoding must not be parallel.
    """
    x = encoding[..., :3] / np.linalg.norm(encoding[..., :3], axis=-1, keepdims=True)
    y = encoding[..., 3:] - np.sum(x * encoding[..., 3:], axis=-1, keepdims=True) * x
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def random_rotation(rng: np.random.Generator) -> Floats:
    """Draw a (3, 3) rotation uniformly from SO(3)."""
    return matrix_from_quat(rng.normal(size=4))


def camera_matrix(focal_px: float, width: int, height: int) -> Floats:
    """Return the (3, 3) camera matrix with square pixels and the principal point at the centre of the image.

    Args:
        focal_px: Focal length [px].
        width: Width of the image [px].
        height: Height of the image [px].
    """
    return np.array([[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]])


def require_camera(K: Floats, width: int, height: int) -> None:
    """Raise ``ValueError`` unless a (3, 3) camera matrix [px] can be that of an image of this size.

    The principal point may lie outside the image, as in a crop of a larger one, but no side of the image may be farther
    than 80 degrees from the optical axis. Fields of view from 0.5 to 170 degrees are accepted: cameras of bins have 10
    to 120, and a crop sees a part of that.
    """
    require_shape("K", K, (3, 3))
    if not (np.all(np.isfinite(K)) and K[0, 0] > 0 and K[1, 1] > 0):
        raise ValueError(f"K must be finite with positive focal lengths, got {K.tolist()}")
    if not np.allclose([*K[2], K[1, 0]], [0.0, 0.0, 1.0, 0.0], rtol=0, atol=1e-9):
        raise ValueError(f"K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {K.tolist()}: is it transposed?")
    if abs(K[0, 1]) > _SKEW:
        raise ValueError(
            f"K must have no skew, got K[0, 1] = {K[0, 1]:g} px: calibrate without skew, or rectify the images"
        )
    for name, unit, size, focal, centre in (
        ("fx", "width", width, K[0, 0], K[0, 2]),
        ("fy", "height", height, K[1, 1], K[1, 2]),
    ):
        view = 2 * float(np.degrees(np.arctan2(size / 2, focal)))
        if not _FIELDS_OF_VIEW[0] <= view <= _FIELDS_OF_VIEW[1]:
            raise ValueError(
                f"K does not fit the image: with {name} = {focal:g} px, a {unit} of {size} px is a field of view of "
                f"{view:.3g} degrees, which must be between {_FIELDS_OF_VIEW[0]:g} and {_FIELDS_OF_VIEW[1]:g}; "
                "focal lengths are in pixels of this image"
            )
        outside = max(-centre, centre - size, 0.0)
        angle = float(np.degrees(np.arctan2(outside + size, focal))) if outside > 0 else 0.0
        if angle > _OFF_AXIS:
            raise ValueError(
                f"K does not fit the image: its principal point ({K[0, 2]:g}, {K[1, 2]:g}) px lies so far outside the "
                f"image of {width} x {height} px that a side of it would be {angle:.1f} degrees off the optical axis, "
                f"which must be at most {_OFF_AXIS:g}; K must be that of this resolution and crop"
            )


def project_points(K: Floats, points_cam: Floats) -> Floats:
    """Project (N, 3) camera points with z > 0 to (N, 2) pixels (u right, v down)."""
    uvw = points_cam @ K.T
    return uvw[:, :2] / uvw[:, 2:]


def pixel_rays(K: Floats, pixels: NDArray[np.number]) -> Floats:
    """Return (N, 3) camera points at depth 1 that (N, 2) pixels (u right, v down) show."""
    x = (pixels[:, 0] - K[0, 2]) / K[0, 0]
    y = (pixels[:, 1] - K[1, 2]) / K[1, 1]
    return np.column_stack([x, y, np.ones(len(pixels))])


def ray_lengths(K: Floats, columns: NDArray[np.number], rows: NDArray[np.number]) -> Floats:
    """Return the (R, C) distances from the camera's centre of the points at depth 1 that pixels show.

    Args:
        K: (3, 3) camera matrix [px].
        columns: (C,) columns u of the pixels.
        rows: (R,) rows v of the pixels.
    """
    x, y = (columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1]
    lengths: Floats = np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    return lengths


def sampling_step(pixels: int, most: int) -> int:
    """Return the distance of the rows and columns of an image of so many pixels that leave about ``most`` [px]."""
    return max(int(np.ceil(np.sqrt(pixels / most))), 1)


def deproject_depth(K: Floats, depth: NDArray[np.floating]) -> Floats:
    """Return the organised cloud of a depth image: (H, W, 3) points in the camera frame [m].

    Pixels without depth (0 or NaN) give the origin or NaN. :attr:`Frame.valid` masks them.

    Args:
        K: (3, 3) camera matrix [px].
        depth: (H, W) depth along the optical axis [m].
    """
    height, width = depth.shape
    u = (np.arange(width) - K[0, 2]) / K[0, 0]
    v = (np.arange(height) - K[1, 2]) / K[1, 1]
    z = depth.astype(np.float64)
    return np.stack([z * u[None, :], z * v[:, None], z], axis=-1)
