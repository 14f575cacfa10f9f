#!/usr/bin/env bash
# pyrealsense2 2.59.1: recordings keep the unit of depth to a whole micrometre; a unit of 12.5 um is played back as 12 um, 4 % too near.
# Source: found by experiment, run on 2026-11-29. Remedy: record with a unit of whole micrometres, or scale what is read by the unit that was set.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check pyrealsense2==2.59.1.11053 numpy==2.4.6 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
import sys
from pathlib import Path

import numpy as np
import pyrealsense2 as rs

WIDTH, HEIGHT = 64, 48
STORED = 40_000  # the depth image, in units


def record(path, unit):
    """Record one frame of a software device, and return the distance that the live frame states [m]."""
    device = rs.software_device()
    sensor = device.add_sensor("depth")
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = WIDTH, HEIGHT, 60.0, 60.0, 31.5, 23.5
    lens.model, lens.coeffs = rs.distortion.brown_conrady, [0.0] * 5
    stream = rs.video_stream()
    stream.type, stream.fmt, stream.intrinsics = rs.stream.depth, rs.format.z16, lens
    stream.index, stream.uid, stream.width, stream.height, stream.fps, stream.bpp = 0, 0, WIDTH, HEIGHT, 30, 2
    profile = sensor.add_video_stream(stream)
    sensor.add_read_only_option(rs.option.depth_units, unit)
    queue = rs.syncer()
    recorder = rs.recorder(str(path), device)
    recorded = recorder.query_sensors()[0]
    recorded.open(recorded.get_stream_profiles()[0])
    recorded.start(queue)
    frame = rs.software_video_frame()
    frame.stride, frame.bpp, frame.timestamp, frame.frame_number = 2 * WIDTH, 2, 1.0, 1
    frame.domain, frame.profile = rs.timestamp_domain.hardware_clock, profile.as_video_stream_profile()
    frame.pixels, frame.depth_units = np.full((HEIGHT, WIDTH), STORED, np.uint16), unit
    sensor.on_video_frame(frame)
    live = queue.wait_for_frames(2000).get_depth_frame().get_distance(20, 20)
    recorded.stop()
    recorded.close()
    return live


def played(path):
    device = rs.context().load_device(str(path))
    device.set_real_time(False)
    sensor, queue = device.query_sensors()[0], rs.frame_queue(10)
    sensor.open(sensor.get_stream_profiles()[0])
    sensor.start(queue)
    distance = queue.wait_for_frame(2000).as_depth_frame().get_distance(20, 20)
    sensor.stop()
    sensor.close()
    return distance


found = {}
for unit in (0.0001, 0.0000125):
    path = Path(sys.argv[1]) / f"{unit}.db3"
    live = record(path, unit)
    found[unit] = live, played(path)
print("pyrealsense2 2.59.1.11053; first seen 2026-11-29")
print("one would expect: a recording plays back the distances that the camera stated")
print("what happens:     distance of a pixel, live and played back")
for unit, (live, back) in found.items():
    print(f"                  unit {1e6 * unit:g} um: {live:.4f} m and {back:.4f} m")
print("so:               the unit is written with six decimals of a metre; all distances shrink by 4 %, and nothing is said")
assert np.isclose(*found[0.0001]), "whole micrometres should be kept"
assert np.allclose(found[0.0000125], [0.5, 0.48], atol=1e-4), "the behaviour changed"
PY
"$dir/venv/bin/python" "$dir/run.py" "$dir"
