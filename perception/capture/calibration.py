"""The calibration of a depth camera: camera matrix, lens distortion, image size, unit of depth and pose."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry import Floats, as_floats, invert_transform, make_transform, require_rigid

DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)  # numbers of coefficients that OpenCV's model takes
ASPECT = 0.01  # largest relative difference of the two factors by which an image was scaled; sizes are whole pixels


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """Calibration of a depth camera, as a file or a driver states it. Lists, tuples and float32 arrays are accepted.

    Attributes:
        K: (3, 3) camera matrix without skew [px], pixel centres at whole numbers.
        distortion: (0, 4, 5, 8, 12 or 14) coefficients in OpenCV's order, k1 k2 p1 p2 k3 k4 k5 k6 and so on: plumb_bob
            has five, rational_polynomial eight.
        size: Width and height of the calibrated image [px]; None if unknown.
        depth_scale: Length of one unit of the depth image [m]; None if unknown.
        T_world_cam: (4, 4) camera pose, OpenCV axes; None if unknown.
    """

    K: Floats
    distortion: Floats = field(default_factory=lambda: np.zeros(0))
    size: tuple[int, int] | None = None
    depth_scale: float | None = None
    T_world_cam: Floats | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "K", require_camera_matrix(self.K))
        distortion = as_floats("distortion", self.distortion).reshape(-1)
        if len(distortion) not in DISTORTION_LENGTHS or not np.isfinite(distortion).all():
            raise ValueError(
                f"distortion must be {', '.join(map(str, DISTORTION_LENGTHS))} finite coefficients in OpenCV's order "
                f"k1 k2 p1 p2 k3 ..., got {distortion.tolist()}"
            )
        object.__setattr__(self, "distortion", distortion)
        if self.size is not None:
            width, height = (int(length) for length in self.size)
            if min(width, height) < 1:
                raise ValueError(f"size must be a positive width and height [px], got {self.size}")
            object.__setattr__(self, "size", (width, height))
        if self.depth_scale is not None:
            require_length("depth_scale", self.depth_scale)
        if self.T_world_cam is not None:
            object.__setattr__(self, "T_world_cam", require_pose("T_world_cam", self.T_world_cam))

    def scaled(self, size: tuple[int, int]) -> "Calibration":
        """Return the calibration of the whole image scaled to another size.

        Args:
            size: New width and height [px].

        Raises:
            ValueError: The calibrated size is unknown, or the ratio of the sides differs.
        """
        if self.size is None:
            raise ValueError("a calibration without an image size cannot be scaled: give the size of its image")
        sx, sy = size[0] / self.size[0], size[1] / self.size[1]
        if abs(sx / sy - 1) > ASPECT:
            raise ValueError(
                f"an image of {_text(self.size)} pixels cannot be scaled to {_text(size)}: the ratio of its sides "
                "differs; if it was cropped, use Calibration.cropped (on the command line, the calibration of the "
                "cropped image)"
            )
        # Pixel centres are whole numbers, so that the image begins at -0.5.
        A = np.array([[sx, 0, 0.5 * sx - 0.5], [0, sy, 0.5 * sy - 0.5], [0, 0, 1]])
        return replace(self, K=A @ self.K, size=size)

    def cropped(self, u0: int, v0: int, width: int, height: int) -> "Calibration":
        """Return the calibration of the part of the image that a camera or a program cut out.

        Args:
            u0: Column of the first pixel kept.
            v0: Row of the first pixel kept.
            width: Columns kept.
            height: Rows kept.

        Raises:
            ValueError: The rectangle is not of whole pixels, or does not lie in the image.
        """
        u0, v0, width, height = require_inside((u0, v0, width, height), self.size)
        K = self.K.copy()
        K[:2, 2] -= (u0, v0)
        return replace(self, K=K, size=(width, height))

    def require_size(self, size: tuple[int, int]) -> None:
        """Raise ``ValueError`` unless the calibration is one of images of ``size``, or its size is unknown."""
        if self.size not in (None, size):
            raise ValueError(
                f"the image must have the calibrated size {_text(self.size or size)}, got {_text(size)}: if the whole "
                'image was scaled, set fit="scale" (--fit scale on the command line); if it was cropped, use '
                "Calibration.cropped (on the command line, the calibration of the cropped image)"
            )


def require_inside(crop: Sequence[float], size: tuple[int, int] | None) -> tuple[int, int, int, int]:
    """Return the rectangle (u0, v0, width, height) of whole pixels in an image of ``size``, None if that is unknown.

    Raises:
        ValueError: The rectangle is not of whole pixels, has none, or does not lie in the image.
    """
    if not all(float(value).is_integer() for value in crop):
        raise ValueError(f"a crop (u0, v0, width, height) must be of whole pixels, got {tuple(crop)}")
    u0, v0, width, height = (int(value) for value in crop)
    inside = size is None or (u0 + width <= size[0] and v0 + height <= size[1])
    if u0 < 0 or v0 < 0 or width < 1 or height < 1 or not inside:
        where = "the image" if size is None else f"the image of {_text(size)} pixels"
        raise ValueError(f"a crop (u0, v0, width, height) must lie in {where}, got {tuple(crop)}")
    return u0, v0, width, height


def require_length(name: str, value: object, option: str = "") -> None:
    """Raise ``ValueError`` unless a value is a positive length [m] per unit."""
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not (number and 0 < value < np.inf):  # type: ignore[operator]
        raise ValueError(f"{name} must be a positive length [m] per unit, got {value}{option}")


def require_camera_matrix(K: ArrayLike) -> Floats:
    """Return K as a (3, 3) float64 array.

    Raises:
        ValueError: K has another shape or last row, focal lengths that are not positive, or skew.
    """
    matrix = as_floats("K", K).copy()
    if matrix.shape != (3, 3):
        raise ValueError(f"K must be (3, 3), got {matrix.shape}")
    if not (np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise ValueError(f"K must be finite with positive focal lengths, got {matrix.tolist()}")
    if matrix[0, 1] != 0:
        raise ValueError(
            f"K must have no skew, got K[0, 1] = {matrix[0, 1]:g} px: calibrate without skew, or rectify the images"
        )
    if matrix[1, 0] != 0 or matrix[2].tolist() != [0, 0, 1]:
        raise ValueError(f"K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {matrix.tolist()}: is it transposed?")
    return matrix


def require_pose(name: str, pose: ArrayLike) -> Floats:
    """Return a pose as a (4, 4) float64 array.

    Raises:
        ValueError: The pose has another shape or is not rigid, or its axes are left-handed.
    """
    T = as_floats(name, pose).copy()
    require_rigid(name, T)
    return T


def pose_from_world_to_camera(rotation: ArrayLike, translation: ArrayLike) -> Floats:
    """Return ``T_world_cam`` of the (3, 3) rotation and (3,) translation [m] that map the world to the camera."""
    R, t = as_floats("rotation", rotation), as_floats("translation", translation)
    if R.size != 9 or t.size != 3:
        raise ValueError(f"rotation and translation must have 9 and 3 numbers, got {R.size} and {t.size}")
    T_cam_world = make_transform(R.reshape(3, 3), t.reshape(3))
    return invert_transform(require_pose("the pose of the world in the camera", T_cam_world))


def _text(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"
