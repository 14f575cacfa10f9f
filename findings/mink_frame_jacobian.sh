#!/usr/bin/env bash
# mink 1.3.0: FrameTask's Jacobian forgets that turning moves the error's translation once the rotation error is below 1e-5 rad.
# Source: found by comparing with finite differences, run on 2026-11-29. Remedy: turn the target of a straight move by 2e-5 rad, which nobody feels.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check mink==1.3.0 mujoco==3.17.0 numpy==2.4.6 "qpsolvers[daqp]==4.13.0" daqp==0.11.0 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
from importlib.metadata import version

import mink
import mujoco
import numpy as np

ARM = """<mujoco><worldbody><body pos="0 0 0.3"><joint axis="0 0 1"/><geom size="0.01"/>
<body pos="0 0 0.2"><joint axis="0 1 0"/><geom size="0.01"/><body pos="0 0 0.4"><joint axis="0 1 0"/><geom size="0.01"/>
<body pos="0 0 0.4"><joint axis="1 0 0"/><geom size="0.01"/><body pos="0 0 0.1"><joint axis="0 1 0"/><geom size="0.01"/>
<body pos="0 0 0.05"><joint axis="0 0 1"/><geom size="0.01"/><site name="tcp" pos="0 0 0.1"/></body></body></body></body></body></body>
</worldbody></mujoco>"""
Q, STEP = np.array([0.3, 0.4, 1.0, 0.2, 0.9, 0.1]), 1e-4
configuration = mink.Configuration(mujoco.MjModel.from_xml_string(ARM))
configuration.update(Q)
start = configuration.get_transform_frame_to_world("tcp", "site")
task = mink.FrameTask("tcp", "site", position_cost=1.0, orientation_cost=0.0)
print(f"mink {version('mink')}, MuJoCo {mujoco.__version__}; first seen 2026-11-29")
print("one would expect: a Jacobian equal to differences of compute_error, and nearly equal steps for targets that differ by 2e-6 rad")
print("what happens:     target 0.36 m away, turned by ...")
found = {}
for turn in (0.0, 9e-6, 11e-6, 1e-3):
    rotation = start.rotation() @ mink.SO3.exp(np.array([0.0, 0.0, turn]))
    task.set_target(mink.SE3.from_rotation_and_translation(rotation, start.translation() + [0.0, 0.3, -0.2]))
    columns = []
    for axis in STEP * np.eye(6):
        configuration.update(Q + axis)
        ahead = task.compute_error(configuration)
        configuration.update(Q - axis)
        columns.append((ahead - task.compute_error(configuration)) / (2 * STEP))
    configuration.update(Q)
    gap = abs(task.compute_jacobian(configuration) - np.array(columns).T).max()
    step = mink.solve_ik(configuration, [task], dt=1.0, solver="daqp", limits=[])
    found[turn] = gap, step
    print(f"                  {turn:7.1e} rad: Jacobian off by {gap:.1e} m/rad; joint steps {np.degrees(step).round(1)} deg")
print("so:               SE3.ljacinv returns the identity there, not I - 1/2 ad(xi): half the distance to the target is missing as a lever arm")
print("                  exactly in straight moves, where the orientation stays")
jump = np.degrees(abs(found[9e-6][1] - found[11e-6][1]).max())
print(f"                  largest jump of a joint step between 9e-6 and 11e-6 rad: {jump:.1f} deg")
assert found[11e-6][0] < 1e-5 and found[1e-3][0] < 1e-5, "the Jacobian should be right beyond the threshold"
assert found[0.0][0] > 0.1 and found[9e-6][0] > 0.1 and jump > 5, "the behaviour changed"
PY
"$dir/venv/bin/python" "$dir/run.py"
