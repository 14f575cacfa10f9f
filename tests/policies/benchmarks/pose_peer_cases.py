"""Searches made by hand, and a peer that takes a moment."""

from pathlib import Path

import numpy as np

from binpick_env.parts import load_part
from perception.geometry import Floats, make_transform
from perception.instance import Instance
from policies.benchmarks.pose_peer_inputs import PoseCase
from policies.benchmarks.pose_peers import Peer

TEE = load_part("tee").model
FAKE = """
import os
import numpy as np

asked = []


def version():
    return f"fake {len(asked)} " + os.environ["OMP_NUM_THREADS"] + os.environ.get("PYTHONPATH", "")


def build(model, d_max, threads, setting):
    assert model.shape[1] == 6 and d_max > 0

    def estimate(points, top):
        asked.append(top)
        if setting == "fail":
            raise ArithmeticError("no pose today")
        poses = np.tile(np.eye(4), (top, 1, 1))
        poses[:, :3, 3] = points[:, :3].mean(axis=0)
        poses[:, 0, 3] += np.arange(top) + 10 * threads
        return poses[: int(setting)], -np.arange(top)[: int(setting)]

    return estimate
"""


def case(T: Floats | None = None, top: int = 1, *, whole: bool = False, points: Floats | None = None) -> PoseCase:
    T_cam_parts = np.reshape(make_transform(translation=(0, 0, 1)) if T is None else T, (-1, 4, 4))
    return PoseCase(
        scene=0,
        instance=None if whole else Instance(point_idx=np.arange(3), score=1.0),
        points=np.ones((5, 6)) if points is None else points,
        T_cam_parts=T_cam_parts,
        to_find=np.ones(len(T_cam_parts), np.bool_),
        top=top,
    )


def fake_peer(folder: Path) -> Peer:
    """Return a peer that finds poses at the points' mean, moved by its threads; its setting says how many."""
    method = folder / "fake.py"
    method.write_text(FAKE)
    return Peer(name="Fake", family="fake", method=method, probe="import numpy", packages=("numpy",), setting="9")
