"""Malformed arrays: frames, camera matrices, poses and bins as a program of the user's passes them."""

from pathlib import Path
from typing import Any

import numpy as np

from perception.boundary import extract_boundary
from perception.capture import Calibration, read_frame
from perception.frame import Frame, Workspace
from perception.geometry import rotation_about
from policies.soak.fuzz.damage import choose, damaged_array
from policies.soak.fuzz.grammar import Case
from policies.soak.fuzz.samples import Samples


def frame(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:  # noqa: ARG001 - the form of a grammar
    """A frame with one or two damaged fields, of which the boundary is then taken."""
    whole = samples.frame()
    values: dict[str, Any] = {name: getattr(whole, name) for name in ("grey", "depth", "K", "T_world_cam")}
    for name in rng.choice(list(values), int(rng.integers(1, 3)), replace=False):
        values[name] = damaged_array(rng, np.asarray(values[name]))
    if rng.random() < 0.1:
        a, b = rng.choice(list(values), 2, replace=False)
        values[a], values[b] = values[b], values[a]
    return lambda: extract_boundary(Frame(**values), samples.workspace)


def intrinsics(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:  # noqa: ARG001 - the form of a grammar
    """A camera matrix that is damaged, skewed, in other units, or that of another image."""
    K = samples.frame().K
    kinds = (
        damaged_array(rng, K),
        K + np.array([[0, rng.normal() * 100, 0], [0, 0, 0], [0, 0, 0]]),
        K * np.array([[choose(rng, (-1, 1e-3, 10, 1e6))], [1], [1]]),
        K[:, rng.permutation(3)],
        K.tolist()[: int(rng.integers(4))],
        [[choose(rng, (None, "f", 300.0, np.nan)) for _ in range(3)] for _ in range(3)],
    )
    chosen = choose(rng, kinds)
    distortion = rng.normal(size=int(rng.integers(15))) * choose(rng, (0.0, 0.1, 100.0))
    if rng.random() < 0.5:
        return lambda: read_frame(samples.folder / "small_depth.png", calibration=chosen)
    return lambda: read_frame(
        samples.folder / "small_depth.png",
        calibration=Calibration(K=chosen, distortion=distortion, size=(160, 120), depth_scale=0.0001),
    )


def pose(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:  # noqa: ARG001 - the form of a grammar
    """A bin or a camera whose pose is no rotation and translation, or in millimetres, or turned."""
    whole, workspace = samples.frame(), samples.workspace
    T = np.eye(4)
    T[:3, :3] = rotation_about(rng.normal(size=3), float(rng.uniform(0, np.pi)))
    T[:3, 3] = rng.normal(size=3)
    scaled, mirrored = T.copy(), T.copy()
    scaled[:3, :3] *= choose(rng, (0.001, 1.01, 2.0, 1000.0))
    mirrored[:3, int(rng.integers(3))] *= -1
    far = T.copy()
    far[:3, 3] *= 1000
    kinds = (damaged_array(rng, T), scaled, mirrored, far, T.T, T[:3], T[:3, :3], T.tolist(), "identity", None)
    chosen: Any = choose(rng, kinds)
    size: Any = choose(rng, (workspace.inner_size, damaged_array(rng, workspace.inner_size), [0.3, 0.2], 0.3, "large"))
    if rng.random() < 0.5:
        return lambda: extract_boundary(whole, Workspace(T_world_bin=chosen, inner_size=size))
    return lambda: extract_boundary(Frame(grey=whole.grey, depth=whole.depth, K=whole.K, T_world_cam=chosen), workspace)
