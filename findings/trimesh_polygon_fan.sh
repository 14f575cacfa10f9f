#!/usr/bin/env bash
# trimesh 5.2.0: polygons of an OBJ or PLY file are split into fans, so that triangles cover the notch of an L; volume and watertightness hide it.
# Source: found by comparing readers of part files, run on 2026-11-29. Remedy: triangulate before export, and compare areas with another reader's.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check trimesh==5.2.0 mujoco==3.17.0 numpy==2.4.6 scipy==1.17.1 rtree==1.4.1 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
import sys

import mujoco
import numpy as np
import trimesh

OUTLINE = [(0, 0), (4, 0), (4, 1), (1, 1), (1, 4), (0, 4)]  # an L with arms 1 wide, extruded by 1: area 30, volume 7
corners = [(x, y, z) for z in (0, 1) for x, y in OUTLINE]
path, seen = sys.argv[1], {}


def area(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


print(f"trimesh {trimesh.__version__}, MuJoCo {mujoco.__version__}; first seen 2026-11-29")
print("one would expect: surface 30 and volume 7, the notch at (1.5, 1.5) empty, whichever corner a polygon starts at; else not watertight")
print("what happens:")
for start in (0, 1):
    caps = [list(np.roll([5, 4, 3, 2, 1, 0], -start)), list(np.roll([6, 7, 8, 9, 10, 11], -start))]
    polygons = caps + [[k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6)]
    lines = ["v %g %g %g" % corner for corner in corners]
    lines += ["f " + " ".join(str(index + 1) for index in polygon) for polygon in polygons]
    open(path, "w").write("\n".join(lines) + "\n")
    mesh = trimesh.load_mesh(path)
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><asset><mesh name="part" file="{path}" inertia="exact"/></asset>'
        '<worldbody><body><freejoint/><geom type="mesh" mesh="part" density="1"/></body></worldbody></mujoco>'
    )
    model = spec.compile()
    notch, column = bool(mesh.contains([[1.5, 1.5, 0.5]])[0]), float(trimesh.proximity.signed_distance(mesh, [[1.5, 1.5, 1.05]])[0])
    seen[start] = (mesh.area, mesh.volume, mesh.is_watertight, mesh.is_winding_consistent, notch, column)
    reference = (area(model.mesh_vert, model.mesh_face), float(model.body_mass[1]))
    print(
        f"  caps start at corner {start}: trimesh surface {mesh.area:.1f}, volume {mesh.volume:.1f}, watertight {mesh.is_watertight}, "
        f"winding consistent {mesh.is_winding_consistent}, contains a point of the notch: {notch}, "
        f"distance of a point in it to the surface {-column:.2f}"
    )
    print(f"                           MuJoCo  surface {reference[0]:.1f}, volume {reference[1]:.1f} (ear clipping)")
    assert np.allclose(reference, (30, 7), atol=1e-4), "MuJoCo's reading should be right"
print("so:               volume, mass and inertia stay right, since overlapping triangles cancel; sampled points, normals and distances do not")
assert np.allclose([seen[0][0], seen[1][0]], [39, 48]), "the behaviour changed"
assert all(np.isclose(s[1], 7) and s[2] and s[3] for s in seen.values()), "the behaviour changed"
assert (seen[0][4], seen[1][4]) == (False, True), "the behaviour changed"
PY
"$dir/venv/bin/python" "$dir/run.py" "$dir/part.obj"
