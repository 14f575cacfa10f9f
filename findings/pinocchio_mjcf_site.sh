#!/usr/bin/env bash
# Pinocchio 4.1.0: read from MJCF, a site on a body without joints is off by the offset of the joint above it; its body is right.
# Source: found by comparing forward kinematics with MuJoCo 3.17.0, run on 2026-11-29. Remedy: joints at their bodies' origins, or sites on the moved body.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check pin==4.1.0 mujoco==3.17.0 numpy==2.4.6 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
import sys

import mujoco
import numpy as np
import pinocchio

MODEL = """<mujoco><worldbody><body name="link">
  <joint name="hinge" axis="0 1 0" pos="{offset} 0 0"/><geom size="0.05"/>
  <body name="flange" pos="0 0 0.3"><geom name="pad" size="0.02" pos="0 0 0.1"/><site name="tcp" pos="0 0 0.1"/></body>
</body></worldbody></mujoco>"""
path, worst = sys.argv[1], {}
print(f"Pinocchio {pinocchio.__version__}, MuJoCo {mujoco.__version__}; first seen 2026-11-29")
print("one would expect: both programs put every frame of one MJCF file at the same place, whatever the hinge's pos")
print("what happens:     distance between Pinocchio's and MuJoCo's place at q = 0.5 rad [m]")
for offset in (0.0, 0.1):
    open(path, "w").write(MODEL.format(offset=offset))
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    data.qpos[0] = 0.5
    mujoco.mj_forward(model, data)
    other = pinocchio.buildModelFromMJCF(path)
    other = other[0] if isinstance(other, tuple) else other
    state = other.createData()
    q = np.array([0.5])
    pinocchio.framesForwardKinematics(other, state, q)
    geometry = pinocchio.buildGeomFromMJCF(other, path, pinocchio.COLLISION)
    geometry = geometry[-1] if isinstance(geometry, tuple) else geometry
    placed = geometry.createData()
    pinocchio.updateGeometryPlacements(other, state, geometry, placed)
    place = {name: state.oMf[other.getFrameId(name)].translation for name in ("link", "flange", "tcp")}
    pad = min(placed.oMg, key=lambda T: np.linalg.norm(T.translation - data.geom("pad").xpos)).translation
    true = {"link": data.body("link").xpos, "flange": data.body("flange").xpos, "tcp": data.site("tcp").xpos}
    gap = {name: float(np.linalg.norm(place[name] - true[name])) for name in true}
    gap["pad (geom)"] = float(np.linalg.norm(pad - data.geom("pad").xpos))
    gap["gravity [N m]"] = float(abs(pinocchio.computeGeneralizedGravity(other, state, q) - data.qfrc_bias).max())
    worst[offset] = gap
    print(f"                  hinge pos {offset} m: " + ", ".join(f"{name} {value:.4f}" for name, value in gap.items()))
print("so:               inverse kinematics of the tool's site misses by the joint's offset, while masses, bodies and geoms agree")
assert max(worst[0.0].values()) < 1e-6, "the programs should agree without an offset"
assert abs(worst[0.1]["tcp"] - 0.1) < 1e-6 and worst[0.1]["flange"] < 1e-6, "the behaviour changed"
PY
"$dir/venv/bin/python" "$dir/run.py" "$dir/model.xml"
