"""Each test process computes on one thread: pytest-xdist starts as many processes as there are cores."""

import os

# Read by OpenMP, BLAS and numba when they are loaded, and by the processes that tests start.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import cv2  # noqa: E402

cv2.setNumThreads(1)
