"""The convex decomposition as a program of its own, since CoACD may end the process that calls it by a signal.

`main` reads ``vertices`` and ``faces`` from an .npz file, takes CoACD's settings as JSON, and writes another .npz file
with the ``vertices`` of all pieces and their ``counts``.
"""

import json
from collections.abc import Callable
from typing import Any

import numpy as np


def main(source: str, settings: str, target: str) -> None:
    """Decompose a mesh file into the vertices of convex pieces."""
    import coacd

    coacd.set_log_level("off")
    as_coacd: Callable[..., Any] = coacd.Mesh  # untyped there
    with np.load(source) as mesh:
        found = coacd.run_coacd(as_coacd(mesh["vertices"], mesh["faces"]), **json.loads(settings))
    pieces = [np.asarray(vertices, np.float64) for vertices, _ in found]
    np.savez(
        target,
        vertices=np.concatenate([np.zeros((0, 3)), *pieces]),
        counts=np.array([len(piece) for piece in pieces], np.int64),
    )
