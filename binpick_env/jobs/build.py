"""The build of the project that a process runs: two processes of one build compute the same bits."""

import hashlib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from perception.runtime.provenance import versions

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("perception", "binpick_env", "policies")
_SUFFIXES = (".py", ".json", ".npz", ".safetensors")  # code, noise models, tables and networks
_OF_MACHINE = ("platform", "cores")


@lru_cache(maxsize=1)
def build() -> Mapping[str, str]:
    """Return the versions of Python and of the packages that results depend on, and a SHA-256 of the project's files.

    Two checkouts of one version differ in the latter.
    """
    total = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((_ROOT / package).rglob("*")):
            if path.suffix in _SUFFIXES and path.is_file():
                total.update(f"{path.relative_to(_ROOT).as_posix()}\0".encode() + path.read_bytes())
    found = {name: version for name, version in versions().items() if name not in _OF_MACHINE}
    return found | {"binpick's files": total.hexdigest()[:12]}


def differences(given: Mapping[str, str], other: Mapping[str, str]) -> list[str]:
    """Return what differs between two builds, each as ``name: given, other``."""
    names = [name for name in {**given, **other} if given.get(name) != other.get(name)]
    return [f"{name}: {given.get(name, 'unknown')}, {other.get(name, 'unknown')}" for name in names]
