"""Compiles the kernels that most tests use, and the tests themselves: `python -m tests.compiled_kernels`.

A process that compiles a kernel keeps what the compiler needed, 300 MB for all of them, and one that rewrites the
assertions of all tests another 200 MB; two processes that start together do both twice. Test processes that load what
was compiled stay small.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from perception.depth_edges import depth_edges
from perception.s3dis.data.annotation import read_annotation
from policies.commands.main import main

FEW = ("--min-parts", "2", "--max-parts", "2")


def pick(folder: Path) -> None:
    """Pick the parts of a small bin from pixels."""
    three = ["--min-parts", "3", "--max-parts", "3"]
    main(["pick", "--part", "tee", "--bins", "1", *three, "--no-html", "--out", str(folder)])


def prepare(folder: Path) -> None:
    """Use what a pick does not: a part that was never loaded, other cameras and networks, rooms."""
    part, scenes = str(folder / "part.stl"), str(folder / "scenes")
    trimesh.creation.box((0.06, 0.04, 0.02)).export(part)
    generate = ["generate-scenes", "--part", part, "--count", "4", *FEW, "--workers", "1", "--out", scenes]
    main([*generate, "--sensor", "stereo", "--backend", "rays", "--width", "320", "--height", "240"])
    for preset in ("paper", "dgcnn-context"):
        length = ["--steps", "1", "--batch", "1", "--held-out", "1", "--initial", "none", "--install", "False"]
        train = ["train-segmentation", "--part", part, "--scenes", scenes, "--preset", preset, *length]
        main([*train, "--threads", "1", "--no-tensorboard", "--out", str(folder / preset)])
    main(["evaluate-segmentation", "--part", part, "--count", "1", *FEW, "--method", "euclidean", "--no-html"])
    depth_edges(np.ones((48, 64), np.float32), np.diag([60.0, 60.0, 1.0]))
    (folder / "room.txt").write_text("1.0 2.0 3.0 10 20 30\n", encoding="utf-8")
    read_annotation(folder / "room.txt", "room.txt")


JOBS: dict[str, Callable[[Path], None]] = {job.__name__: job for job in (pick, prepare)}


def compile_kernels(name: str) -> None:
    """Do one of the jobs in a folder that is deleted afterwards; models that another run cached would compile less."""
    with tempfile.TemporaryDirectory() as made:
        os.environ["BINPICK_CACHE"] = made
        os.chdir(made)
        JOBS[name](Path(made))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        compile_kernels(sys.argv[1])
    else:  # side by side
        collect = ("pytest", "--collect-only", "-q", "-p", "no:cacheprovider")
        calls = [("tests.compiled_kernels", name) for name in JOBS] + [collect]
        started = [subprocess.Popen([sys.executable, "-m", *words]) for words in calls]
        sys.exit(max(process.wait() for process in started))
