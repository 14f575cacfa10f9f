"""Inputs that both builds are given: piles of parts, and frames of them."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.config import SensorPreset
from binpick_env.env import BinPickEnv
from binpick_env.parts.unit import Unit
from perception.runtime.threads import one_core

WITH_PILES = ("frame", "camera", "attempt")  # works whose inputs are made here; the others draw their own from the seed


@dataclass(frozen=True, kw_only=True)
class BuildJob:
    """What two builds are compared by.

    Attributes:
        work: Name of the work; a function of `works.py`.
        part: Name of a part, or path of a part file.
        unit: Unit of a part file's coordinates; guessed unless given.
        count: Number of parts in the bin.
        seed: Seed of the first input; input k has seed + k.
        sensor: Noise of the depth camera.
        repeats: Number of inputs; each build does the work once on each.
        threads: Number of threads of each build.
    """

    work: str
    part: str = "tee"
    unit: Unit | None = None
    count: int = 25
    seed: int = 0
    sensor: SensorPreset = "good"
    repeats: int = 12
    threads: int = 1

    def __post_init__(self) -> None:
        for name in ("count", "repeats", "threads"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")

    def arguments(self, inputs: Path) -> dict[str, Any]:
        """Return what a build is told: these settings, and the path of the file of inputs."""
        return {**asdict(self), "inputs": str(inputs)}


def save_inputs(path: Path, job: BuildJob) -> None:
    """Write the inputs of a job as an NPZ file; an empty one for a work that draws its own.

    Args:
        path: File to write. ``T_world_part`` (N, P, 4, 4) are the piles. For frames there are ``depth_k`` (H, W) and
            ``grey_k`` (H, W), ``T_world_cam`` (N, 4, 4), ``K`` (3, 3), ``T_world_bin`` (4, 4) and ``inner_size`` (3,).
        job: The job.

    Raises:
        ValueError: There is no such part.
        SettleError: A pile did not come to rest.
    """
    arrays: dict[str, Any] = {}
    if job.work in WITH_PILES:
        with one_core():
            piles = list(_piles(job, arrays))
        arrays["T_world_part"] = np.stack(piles)
    np.savez(path, **arrays)


def _piles(job: BuildJob, arrays: dict[str, Any]) -> Iterator[Any]:
    """Yield the (P, 4, 4) poses of each pile; what frames need is added to ``arrays``."""
    env = BinPickEnv(job.part, unit=job.unit, num_parts=job.count, perception="oracle", sensor=job.sensor, threads=1)
    poses_of_camera = []
    for k in range(job.repeats):
        env.reset(seed=job.seed + k)
        yield env.simulation.part_poses()
        if job.work == "frame":
            frame = env.frame
            arrays |= {f"depth_{k}": frame.depth, f"grey_{k}": frame.grey, "K": frame.K}
            poses_of_camera.append(frame.T_world_cam)
    if job.work == "frame":
        bin_ = {"T_world_bin": env.workspace.T_world_bin, "inner_size": env.workspace.inner_size}
        arrays |= {"T_world_cam": np.stack(poses_of_camera), **bin_}
    env.close()
