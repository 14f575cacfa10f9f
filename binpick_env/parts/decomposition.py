"""The convex decomposition by CoACD, in a process of its own."""

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh

from binpick_env.parts.child_program import run_program
from perception.geometry import Floats

PROGRAM = Path(__file__).with_name("_coacd_process.py")
_TIMEOUT = 1800.0  # time after which a decomposition is given up [s]
_ADVICE = "its surfaces may cross each other; export the part as one solid, or repair it, for instance in MeshLab"


def decompose(
    mesh: trimesh.Trimesh, settings: Mapping[str, float | str], *, program: Path = PROGRAM, timeout: float = _TIMEOUT
) -> list[Floats]:
    """Return the (V, 3) vertices of each convex piece that CoACD finds.

    Args:
        mesh: Watertight mesh [m].
        settings: Arguments of ``coacd.run_coacd``.
        program: Python file that is run; see :mod:`._coacd_process`.
        timeout: Time after which it is given up [s].

    Raises:
        ValueError: The program ends by a signal, fails, or takes too long.
    """
    what = f"the convex decomposition of a mesh of {len(mesh.faces)} faces"
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "mesh.npz", Path(folder) / "pieces.npz"
        np.savez(source, vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces))
        arguments = str(source), json.dumps(dict(settings)), str(target)
        run_program(program, arguments, what=what, advice=_ADVICE, timeout=timeout)
        with np.load(target) as found:
            vertices, counts = found["vertices"], found["counts"]
    return np.split(vertices, np.cumsum(counts)[:-1]) if len(counts) else []
