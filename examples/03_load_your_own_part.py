"""A mesh file becomes a part: its unit, mass, largest extent and symmetry."""

import tempfile
from pathlib import Path

import numpy as np
import trimesh

from binpick_env.parts import Part, load_part


def main(folder: Path) -> Part:
    """Write a hexagonal pin as STL in millimetres, and return it as a part."""
    pin = trimesh.creation.cylinder(radius=12.0, height=60.0, sections=6)
    path = folder / "pin.stl"
    pin.export(path)
    part = load_part(path, density=7850.0)  # steel
    model = part.model
    print(f"{path.name}: read in {part.unit}, {1000 * part.mass:.0f} g, d_max {1000 * model.d_max:.1f} mm")
    print(f"{len(part.pieces)} convex collision pieces, {len(model.symmetry.rotations)} rotations map it onto itself")
    print("inertia [kg mm^2]:", np.round(1e6 * np.diag(part.inertia), 2))
    return part


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        main(Path(made))
