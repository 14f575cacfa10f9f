"""A checkout of a project that finds as many poses as it is told to, and notes each call."""

from pathlib import Path

import numpy as np

THREADS = """
from contextlib import nullcontext


def use_threads(count):
    return nullcontext()
"""
FRAME = """
from types import SimpleNamespace


def Frame(**arrays):
    return SimpleNamespace(**arrays)


Workspace = Frame
"""
PARTS = """
from types import SimpleNamespace


def load_part(name):
    return SimpleNamespace(model=name)
"""
PIPELINE = """
from pathlib import Path
from types import SimpleNamespace
import numpy as np

FOUND = {found}


class Pipeline:
    @classmethod
    def for_part(cls, part, workspace{option}):
        assert not {measures}
        return cls()

    def perceive(self, frame):
        with (Path(__file__).parents[2] / "calls.txt").open("a") as calls:
            calls.write(f"{{Path(__file__).parents[1].name}} {{int(frame.depth[0, 0])}}\\n")
        {trouble}
        print("a library prints")
        poses = [SimpleNamespace(T_cam_part=np.eye(4), score=0.5)] * min(FOUND, 1 + int(frame.depth[0, 0]))
        return SimpleNamespace(poses=poses, ms={{"poses": 2.0, "{stage}": 1.0}})
"""


def fake_checkout(folder: Path, *, found: int = 9, older: bool = False, trouble: str = "pass") -> Path:
    """Return a checkout whose frame k has ``found`` poses, k + 1 at most; an older one takes fewer options."""
    threads = folder / ("perception/threads.py" if older else "perception/runtime/threads.py")
    option, measures = ("", "False") if older else (", measure_bin=True", "measure_bin")
    pipeline = PIPELINE.format(
        found=found, option=option, measures=measures, trouble=trouble, stage="old" if older else "new"
    )
    files = {
        folder / "policies/__init__.py": "",
        folder / "perception/__init__.py": "",
        folder / "perception/frame.py": FRAME,
        folder / "perception/pipeline.py": pipeline,
        folder / "binpick_env/__init__.py": "",
        folder / "binpick_env/parts.py": PARTS,
        threads: THREADS,
    }
    for path, text in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def save_small_inputs(path: Path, job: object) -> None:
    """Write five frames of four pixels, which hold their number."""
    frames = {f"depth_{k}": np.full((2, 2), k, np.float32) for k in range(5)}
    frames |= {f"grey_{k}": np.zeros((2, 2), np.uint8) for k in range(5)}
    poses = {"T_world_cam": np.tile(np.eye(4), (5, 1, 1)), "T_world_bin": np.eye(4)}
    np.savez(path, K=np.eye(3), inner_size=np.ones(3), **frames, **poses)
