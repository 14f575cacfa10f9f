#!/usr/bin/env bash
# OpenCV 5.0.0.93: registerDepth takes a uint16 depth image as millimetres and its transform in metres; warpFrame takes both in the image's unit.
# Source: found by experiment, run on 2026-11-29. Remedy: convert depth to float32 metres first (rescaleDepth); with floats the two agree.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
import cv2
import numpy as np

HEIGHT, WIDTH = 120, 160
K = np.array([[150.0, 0.0, 79.5], [0.0, 150.0, 59.5], [0.0, 0.0, 1.0]])
depth_mm = np.full((HEIGHT, WIDTH), 600, np.uint16)
depth_mm[50:70, 60:100] = 500  # a block on the floor
depth = (depth_mm / 1000).astype(np.float32)
move = np.eye(4)
move[2, 3] = 0.1  # 0.1 m further away


def seen(image):
    return [float(round(x, 4)) for x in np.unique(image[np.isfinite(image) & (image > 0)].astype(float))]


def registered(image):
    return seen(cv2.registerDepth(K, K, np.zeros(5), move, image, (WIDTH, HEIGHT)))


def warped(image):
    return seen(cv2.warpFrame(image, np.zeros((HEIGHT, WIDTH, 3), np.uint8), None, move, K)[0])


print(f"OpenCV {cv2.__version__}, NumPy {np.__version__}; first seen 2026-11-29")
print("one would expect: two functions of one module move the same image by the same transform alike")
print("what happens:     floor at 600 mm, block at 500 mm, moved 0.1 m away; depths in the result")
print(f"                  float32 [m]: registerDepth {registered(depth)}, warpFrame {warped(depth)}")
print(f"                  uint16 [mm]: registerDepth {registered(depth_mm)}, warpFrame {warped(depth_mm)}")
print("so:               for uint16 warpFrame reads 0.1 as a tenth of a millimetre; nothing moves, and nothing is said")
assert np.allclose(registered(depth), [0.6, 0.7], atol=1e-4) and np.allclose(warped(depth), [0.6, 0.7], atol=1e-4), "floats should agree"
assert registered(depth_mm) == [600.0, 700.0] and warped(depth_mm) == [500.0, 600.0], "the behaviour changed"
PY
"$dir/venv/bin/python" "$dir/run.py"
