"""The side of `policies.benchmarks.builds.process` that runs in a process of one build, and imports only that build.

Requests and answers are lines of JSON. ``{"index": k}`` does the work on input k once and is answered with its times;
``{}`` ends the process and is answered with its memory.
"""

import hashlib
import json
import os
import resource
import runpy
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


def serve(works_file: str, work: str, job: str) -> None:
    """Answer requests until the last one.

    Args:
        works_file: Path of `works.py`, which has a function for each work.
        work: Name of the work.
        job: JSON object of what the work depends on beside its input: ``part``, ``count``, ``seed``, ``sensor``,
            ``threads``, and the file ``inputs``; see `works.py`.
    """
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer

    def answer(message: dict[str, Any]) -> None:
        answers.write(json.dumps(message) + "\n")
        answers.flush()

    works = runpy.run_path(works_file)
    try:
        ready = works[work](json.loads(job))
        answer({"packages": _packages(), "memory": peak_memory()})
        for line in sys.stdin:
            request = json.loads(line)
            if not request:
                break
            answer(timed(ready(request["index"])))
        answer({"memory": peak_memory()})
    except works["MissingInterfaceError"] as error:
        answer({"missing": str(error)})


def timed(call: Callable[[], Any]) -> dict[str, Any]:
    """Return wall clock and processor time of ``call()`` [ms], with what its result says of itself.

    Args:
        call: The work on one input. It returns what describes its result: ``values``, the bytes that tell whether two
            builds have the same result; ``fact``, a number or word about it; ``stages``, times of its parts [ms].
    """
    wall, cpu = time.perf_counter(), time.process_time()
    result = call()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    said = result()
    digest = hashlib.sha256(said.get("values", b"")).hexdigest()
    times = {"wall": 1000 * wall, "cpu": 1000 * cpu}
    return {**times, "fact": said.get("fact"), "stages": said.get("stages", {}), "digest": digest}


def peak_memory() -> float:
    """Return the largest resident memory that this process has had [MB]."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:  # not Linux; what is asked here counts bytes on macOS
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    line = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) * 1024 / 1e6


def _packages() -> list[str]:
    """Return the folders that the build's packages were imported from."""
    found = (sys.modules.get(name) for name in ("perception", "binpick_env", "policies"))
    return [str(Path(module.__file__).parent) for module in found if module is not None and module.__file__]
