"""Shape signatures: a few invariants that tell whether two meshes are of one part, whatever file they came from."""

from collections.abc import Sequence

import numpy as np

from perception.geometry import Floats, require_shape
from perception.part import PartModel

TOLERANCE = 2e-3  # largest relative difference of the lengths behind the invariants of one shape

VALUES = 5  # number of values that describe a shape apart from its size
LARGEST = 3.0  # values are limited to this, beyond which no network is trained
# Mean and standard deviation, over generated parts, of the logarithm of the lengths behind the values over d_max.
_MEAN = np.array([0.239, -0.941, -1.742, -1.334, -1.232])
_SPREAD = np.array([0.251, 0.262, 0.413, 0.082, 0.101])

Signature = tuple[float, ...]


def shape_signature(part: PartModel) -> Signature:
    """Return the invariants of a part's shape, in metres.

    They are the largest extent, the square root of the area, the cube root of the volume, and the three radii of
    gyration about the principal axes, in ascending order. Position, attitude, order of the faces and moderate
    remeshing do not change them.

    Raises:
        ValueError: The mesh does not enclose a volume.
    """
    mesh = part.mesh
    if not mesh.volume > 0:
        raise ValueError(f"the mesh of {part.name!r} must enclose a volume, got {mesh.volume:.3g} m^3")
    moments = np.linalg.eigvalsh(mesh.moment_inertia / (mesh.density * mesh.volume))
    gyration = np.sqrt(np.maximum(moments, 0.0))
    return (part.d_max, float(np.sqrt(mesh.area)), float(np.cbrt(mesh.volume)), *(float(r) for r in gyration))


def same_shape(first: Sequence[float], second: Sequence[float]) -> bool:
    """Tell whether two signatures are of one shape: no length differs by more than 0.2 %."""
    if len(first) != len(second):
        return False
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    return bool(np.all(np.abs(a - b) <= TOLERANCE * np.maximum(np.abs(a), np.abs(b))))


def shape_values(signature: Sequence[float] | Floats) -> Floats:
    """Return the (5,) values that describe a shape apart from its size: about 0 for most parts, with a spread of 1.

    They are the lengths of a signature over the largest extent, as standardised logarithms. A slender part has a small
    first radius of gyration, a flat one a small volume for its area.

    Args:
        signature: Invariants of the shape, as :func:`shape_signature` returns them.

    Raises:
        ValueError: ``signature`` does not hold six positive lengths.
    """
    lengths = np.asarray(signature, np.float64)
    require_shape("signature", lengths, (VALUES + 1,))
    if not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise ValueError(f"signature must hold positive lengths, got {lengths.tolist()}")
    values: Floats = np.clip((np.log(lengths[1:] / lengths[0]) - _MEAN) / _SPREAD, -LARGEST, LARGEST)
    return values
