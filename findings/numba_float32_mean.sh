#!/usr/bin/env bash
# Numba 0.68.1: mean, var and sum of a float32 array inside njit add one value after another in float32; NumPy adds pairwise. A depth image loses its millimetres.
# Source: found by experiment, run on 2026-11-29. Remedy: cast to float64 before the reduction, or add in a float64 variable.
set -euo pipefail
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3.11 -m venv "$dir/venv"
"$dir/venv/bin/pip" install -qq --disable-pip-version-check numba==0.68.1 numpy==2.4.6 || { echo "the packages could not be installed" >&2; exit 2; }

cat > "$dir/run.py" <<'PY'
import numba
import numpy as np


@numba.njit
def compiled(values):
    return values.mean(), values.std()


@numba.njit
def compiled_double(values):
    wide = values.astype(np.float64)
    return wide.mean(), wide.std()


depth = np.random.default_rng(0).normal(0.9, 0.001, (1200, 1944)).astype(np.float32)  # a flat floor 0.9 m away, 1 mm of noise [m]
numpy_mean, numpy_std = float(depth.mean()), float(depth.std())
mean, std = (float(x) for x in compiled(depth))
wide_mean, wide_std = (float(x) for x in compiled_double(depth))
print(f"Numba {numba.__version__}, NumPy {np.__version__}; first seen 2026-11-29")
print("one would expect: the same function gives the same mean, but for a last digit, compiled or not (and without fastmath)")
print(f"what happens:     NumPy          mean {numpy_mean * 1e3:8.3f} mm, standard deviation {numpy_std * 1e3:6.3f} mm")
print(f"                  njit, float32  mean {mean * 1e3:8.3f} mm, standard deviation {std * 1e3:6.3f} mm")
print(f"                  njit, float64  mean {wide_mean * 1e3:8.3f} mm, standard deviation {wide_std * 1e3:6.3f} mm")
print(f"so:               the floor moves by {abs(mean - numpy_mean) * 1e3:.1f} mm and its noise is {std / numpy_std:.1f} times too large, from rounding of the sum alone")
assert abs(numpy_mean - 0.9) < 1e-5 and abs(wide_mean - 0.9) < 1e-5 and abs(wide_std - 1e-3) < 1e-5, "the references should be right"
assert abs(mean - numpy_mean) > 2e-3 and std > 2 * numpy_std, "the behaviour changed"
PY
"$dir/venv/bin/python" "$dir/run.py"
