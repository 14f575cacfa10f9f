"""The child process of the fuzz test: it draws cases and judges them, one after the other, until it is told to end."""

import logging
import os
import resource
import tempfile
import warnings
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import numpy as np

from policies.soak.fuzz.commands import whole_perceive_line
from policies.soak.fuzz.grammar import Grammar
from policies.soak.fuzz.grammars import GRAMMARS
from policies.soak.fuzz.judge import Verdict, judge
from policies.soak.fuzz.samples import Samples

MEMORY = 2 << 30  # most memory that a case may add to what the process has [bytes]
_STATUS = Path("/proc/self/status")


def serve(connection: Connection, folder: Path, cache: Path) -> None:
    """Answer cases: each is asked for by grammar and seed; "started" comes before the call, a verdict after it.

    Args:
        connection: Pipe to the parent.
        folder: Folder of the samples.
        cache: Cache folder of the packages in this process, which damaged parts shall not fill for others.
    """
    os.setpgrp()  # so that whoever ends this process can end what it has started, too
    os.environ["BINPICK_CACHE"] = str(cache)
    cv2.setNumThreads(1)
    samples = Samples.in_folder(folder)
    _write_output_to(folder.with_name("child.log"))
    _warm_up(samples)
    connection.send("ready")
    try:
        while True:
            name, seed = connection.recv()
            connection.send(_run(GRAMMARS[name], seed, samples, connection))
    except EOFError:  # the parent has closed the pipe
        return


def _write_output_to(path: Path) -> None:
    """Send what this process and its libraries print, which is much, to a file."""
    logging.disable()
    warnings.simplefilter("ignore")
    log = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for standard in (1, 2):
        os.dup2(log, standard)


def _warm_up(samples: Samples) -> None:
    """Load and compute what the first case of each grammar would, and compile its kernels."""
    for grammar in GRAMMARS.values():
        _run(grammar, (0, 0), samples, None)
    with tempfile.TemporaryDirectory(prefix="case") as name:
        folder = Path(name)
        whole_perceive_line(samples, folder)()


def _run(grammar: Grammar, seed: tuple[int, ...], samples: Samples, connection: Connection | None) -> Verdict:
    """Draw a case into a folder of its own and judge it within the limit of memory."""
    with tempfile.TemporaryDirectory(prefix="case") as name:
        folder = Path(name)
        case = grammar(np.random.default_rng(seed), samples, folder)
        Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")  # the peak of memory counts anew
        before = _bytes("VmRSS")
        if connection is not None:
            connection.send("started")
            resource.setrlimit(resource.RLIMIT_AS, (_bytes("VmSize") + MEMORY, resource.RLIM_INFINITY))
        try:
            verdict = judge(case, folder)
        finally:
            resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        if (used := _bytes("VmHWM") - before) > MEMORY:
            return Verdict(outcome="failure", text=f"it took {used >> 20} MB, {MEMORY >> 20} MB is the limit")
        return verdict


def _bytes(name: str) -> int:
    """Return a size from the process's status [bytes]."""
    lines = _STATUS.read_text(encoding="utf-8").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))
