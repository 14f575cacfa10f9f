"""Programs for the child of the fuzz test, in a module that a new process loads quickly."""

import os
import signal
import subprocess
import sys
from multiprocessing.connection import Connection
from pathlib import Path

from policies.soak.fuzz.judge import Verdict


def toy(connection: Connection, folder: Path, cache: Path) -> None:
    """Do what the name of a grammar says."""
    os.setpgrp()
    connection.send("ready")
    try:
        while True:
            name, _ = connection.recv()
            connection.send("started")
            if name == "sleep":
                child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
                folder.parent.mkdir(exist_ok=True)
                (folder.parent / "pid").write_text(str(child.pid))
                while True:
                    pass
            if name == "signal":
                os.kill(os.getpid(), signal.SIGSEGV)
            if name == "exit":
                os._exit(7)
            connection.send(Verdict(outcome="result", text=str(os.getpid())))
    except EOFError:
        return


def broken(connection: Connection, folder: Path, cache: Path) -> None:
    """End before it is ready."""
