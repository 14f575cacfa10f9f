"""Other people's pose estimation in environments of its own, on the inputs that ours is given.

A peer is a file in `policies/peers` that runs under the interpreter of an environment with its package; the two
packages cannot live beside the project's own OpenCV. Inputs and answers pass through files; see `peers/worker.py`.
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
        name: In the table.
        family: Key of its interpreter, and of the option that names it.
        method: File in the format of `peers/worker.py`.
        probe: Python that fails where the package is missing.
        packages: What pip has to install.
        setting: Handed to the method.
        repeats: Of each case; more than one for a method that is not reproducible.
        whole_scenes: Whether it can search a whole bin.
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
    """What a method found in C cases, each asked R times.

    Attributes:
        version: Of the method.
        build_s: Building its models [s].
        ms: (R, C) wall clock [ms].
        cpu_ms: (R, C) time of all processors [ms].
        poses: For each repeat and case (H, 4, 4) ``T_cam_part``, the best first.
        scores: For each the (H,) scores, higher is better.
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
    """Return the peers that can run; of the others a line is logged that says how to get them."""
    faults = {peer.family: fault(peer, interpreters.get(peer.family)) for peer in {p.family: p for p in peers}.values()}
    for text in filter(None, faults.values()):
        _log.warning(text)
    return [peer for peer in peers if faults[peer.family] is None]


def fault(peer: Peer, python: Path | None) -> str | None:
    """Return why the peer cannot run with this interpreter and what to do about it, or None."""
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
    """Let a peer answer the cases in its own process.

    Args:
        peer: That `available` returned.
        python: Its interpreter.
        model: (M, 6) points on the part [m] and normals, part frame.
        d_max: The part's diameter [m].
        cases: At least one.
        threads: That it may use; it is kept on as many cores.

    Raises:
        ValueError: There is no case.
        RuntimeError: The peer failed; the text ends with what it said last.
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
            said = _last_line(done.stderr) or "no word"
            raise RuntimeError(f"{peer.name} failed with exit code {done.returncode}: {said}")
        return _load(answers)


def thread_variables(threads: int) -> dict[str, str]:
    """Return the variables that hold numerical libraries to so many threads."""
    return dict.fromkeys(_VARIABLES, str(threads))


def _environment(threads: int) -> dict[str, str]:
    """Return a peer's variables: ours, without the paths by which it would find our packages instead of its own."""
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
