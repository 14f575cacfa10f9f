"""Shape signatures: a few invariants that tell whether two meshes are of one part, whatever file they came from."""

from collections.abc import Sequence

import numpy as np

from perception.part import PartModel

TOLERANCE = 2e-3  # largest relative difference of the lengths behind the invariants of one shape

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
