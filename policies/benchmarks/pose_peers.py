"""Pose estimation of other libraries, run in environments of their own on the inputs of our method.

A peer is a file in `policies/benchmarks/peers` that runs under the Python interpreter of an environment with its
package; neither package can be installed beside the project's OpenCV. Inputs and answers are exchanged through files;
see `peers/worker.py`.
"""

import logging
import os
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from perception.geometry import Floats, require_shape
from policies.benchmarks.pose_peer_inputs import PoseCase

_log = logging.getLogger(__name__)
_FOLDER = Path(__file__).parent / "peers"
_LAUNCH = "import runpy, sys; runpy.run_path(sys.argv[1])['serve'](*sys.argv[2:])"
_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "TBB_NUM_THREADS")


@dataclass(frozen=True, kw_only=True)
class Peer:
    """A method that is compared with ours.

    Attributes:
        name: Name in the table.
        family: Library; peers of one family share an interpreter and the command line option that names it.
        method: Path of a Python file with the functions that `peers/worker.py` calls.
        probe: Python code that fails if the package is missing.
        packages: Packages that pip has to install.
        setting: Text that is passed to the method.
        repeats: Number of runs on each case, more than one for a method that is not reproducible.
        whole_scenes: Whether the method can search a whole bin.
    """

    name: str
    family: str
    method: Path
    probe: str
    packages: tuple[str, ...]
    setting: str = ""
    repeats: int = 1
    whole_scenes: bool = False

    def __post_init__(self) -> None:
        if self.repeats < 1:
            raise ValueError(f"repeats must be at least 1, got {self.repeats}")


def _opencv(step: str) -> Peer:
    return Peer(
        name=f"OpenCV PPF + ICP, step {step}",
        family="opencv",
        method=_FOLDER / "opencv_ppf.py",
        probe="import cv2; cv2.ppf_match_3d",
        packages=("opencv-contrib-python-headless", "numpy"),
        setting=step,
        whole_scenes=True,
    )


PEERS = (
    _opencv("0.1"),
    _opencv("0.07"),
    Peer(
        name="Open3D FPFH + RANSAC + ICP",
        family="open3d",
        method=_FOLDER / "open3d_fpfh.py",
        probe="import open3d",
        packages=("open3d-cpu==0.20.0",),
        repeats=5,
    ),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Answers:
    """Poses that a method found in C cases, each repeated R times.

    Attributes:
        version: Version of the method.
        build_s: Time of building the method's models [s].
        ms: (R, C) wall clock time [ms].
        cpu_ms: (R, C) processor time, summed over processors [ms].
        poses: (H, 4, 4) ``T_cam_part``, the best first, for each repeat and case.
        scores: (H,) scores, higher is better, for each repeat and case.
    """

    version: str
    build_s: float
    ms: Floats
    cpu_ms: Floats
    poses: list[list[Floats]]
    scores: list[list[Floats]]

    def __post_init__(self) -> None:
        require_shape("ms", self.ms, (None, None))
        require_shape("cpu_ms", self.cpu_ms, self.ms.shape)
        for name in ("poses", "scores"):
            lengths = {len(row) for row in getattr(self, name)}
            if len(getattr(self, name)) != len(self.ms) or lengths - {self.ms.shape[1]}:
                raise ValueError(f"{name} must be for {self.ms.shape} repeats and cases")


def available(peers: Sequence[Peer], interpreters: Mapping[str, Path | None]) -> list[Peer]:
    """Return the peers that can run; for each other family a warning says how to install it.

    Args:
        peers: Peers to check.
        interpreters: Python interpreter of each family.
    """
    faults = {peer.family: fault(peer, interpreters.get(peer.family)) for peer in {p.family: p for p in peers}.values()}
    for text in filter(None, faults.values()):
        _log.warning(text)
    return [peer for peer in peers if faults[peer.family] is None]


def fault(peer: Peer, python: Path | None) -> str | None:
    """Return why the peer cannot run under the interpreter ``python`` and how to install it; None if it can run."""
    option, place = f"--{peer.family}-python", f"runs/peers/{peer.family}"
    remedy = f"python3 -m venv {place} && {place}/bin/pip install {' '.join(peer.packages)}"
    if python is None:
        return f"{peer.family} is left out; to have it: {remedy}, then {option} {place}/bin/python"
    try:
        done = subprocess.run([str(python), "-c", peer.probe], capture_output=True, text=True, env=_environment(1))
    except OSError as error:
        return f"{peer.family} is left out: {option} {python} cannot be run ({error.strerror}); to have it: {remedy}"
    if done.returncode == 0:
        return None
    return f"{peer.family} is left out: {option} {python} fails ({_last_line(done.stderr)}); to have it: {remedy}"


def run_peer(peer: Peer, python: Path, model: Floats, d_max: float, cases: Sequence[PoseCase], threads: int) -> Answers:
    """Run a peer on the cases in its own process.

    Args:
        peer: Peer that `available` returned.
        python: Interpreter of the peer's environment.
        model: (M, 6) points on the part [m] with unit normals, part frame.
        d_max: Diameter of the part [m].
        cases: Searches, at least one.
        threads: Number of threads that the peer may use; it is pinned to as many cores.

    Raises:
        ValueError: There is no case.
        RuntimeError: The peer failed; the text ends with the last line of its error output.
    """
    if not cases:
        raise ValueError(f"{peer.name} needs at least one case, got none")
    with tempfile.TemporaryDirectory() as folder:
        inputs, answers = Path(folder) / "inputs.npz", Path(folder) / "answers.npz"
        given: dict[str, Any] = {f"case_{k}": case.points for k, case in enumerate(cases)}
        np.savez(inputs, **given, model=model, d_max=d_max, tops=[case.top for case in cases])
        command = [str(python), "-c", _LAUNCH, str(_FOLDER / "worker.py"), str(peer.method), str(inputs), str(answers)]
        command += [str(threads), str(peer.repeats), peer.setting]
        done = subprocess.run(command, capture_output=True, text=True, env=_environment(threads))
        if done.returncode != 0:
            reason = _last_line(done.stderr) or "no output"
            raise RuntimeError(f"{peer.name} failed with exit code {done.returncode}: {reason}")
        return _load(answers)


def thread_variables(threads: int) -> dict[str, str]:
    """Return environment variables that limit numerical libraries to ``threads`` threads."""
    return dict.fromkeys(_VARIABLES, str(threads))


def _environment(threads: int) -> dict[str, str]:
    """Return a peer's environment variables: ours without the paths by which it would import our packages."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    return kept | thread_variables(threads) | {"PYTHONDONTWRITEBYTECODE": "1"}


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else ""


def _load(path: Path) -> Answers:
    with np.load(path) as given:
        ends = np.cumsum(given["counts"])[:-1]
        repeats, cases = given["counts"].shape
        flat = {name: np.split(given[name], ends) for name in ("poses", "scores")}
        rows = {name: [flat[name][r * cases : (r + 1) * cases] for r in range(repeats)] for name in flat}
        return Answers(
            version=str(given["version"]),
            build_s=float(given["build_s"]),
            ms=given["ms"],
            cpu_ms=given["cpu_ms"],
            poses=rows["poses"],
            scores=rows["scores"],
        )
