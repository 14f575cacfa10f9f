"""Pipelines of different parts that several threads use at once, against the same frames one after the other."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from binpick_env.env import BinPickEnv
from perception.frame import Frame
from perception.pipeline import Pipeline
from policies.soak.cell.crowd import HEIGHT, WIDTH


def differences(parts: tuple[str, str], num_parts: tuple[int, int], seed: int, threads: int) -> tuple[int, list[str]]:
    """Perceive frames of two parts on several threads at once, and again one by one.

    All threads use the first part's pipeline at first, then half of them that of the second.

    Args:
        parts: Names of the two parts.
        num_parts: Smallest and largest number of parts in a pile.
        seed: Seed of the piles.
        threads: Number of threads, each with a frame of its own.

    Returns:
        The number of frames perceived at once, and a sentence for each whose poses are not the same bits.
    """
    pipelines, frames = zip(*(_scenes(part, num_parts, seed, threads) for part in parts), strict=True)
    of_first, of_both = [(0, i) for i in range(threads)], [(i % 2, i // 2) for i in range(threads)]

    def seen(at: tuple[int, int]) -> bytes:
        return _bits(pipelines[at[0]], frames[at[0]][at[1]])

    with ThreadPoolExecutor(threads) as pool:
        together = [*pool.map(seen, of_first), *pool.map(seen, of_both)]
    every = [*of_first, *of_both]
    alone = {at: seen(at) for at in set(every)}
    pairs = zip(every, together, strict=True)
    different = [f"{parts[k]}, frame {i}: other poses" for (k, i), bits in pairs if bits != alone[k, i]]
    return len(every), different


def _scenes(part: str, num_parts: tuple[int, int], seed: int, count: int) -> tuple[Pipeline, Sequence[Frame]]:
    """Return the pipeline of a part, and frames of several piles of it."""
    env = BinPickEnv(part=part, num_parts=num_parts, perception="oracle", width=WIDTH, height=HEIGHT)
    frames = []
    for k in range(count):
        env.reset(seed=seed + k)
        frames.append(env.frame)
    env.close()
    return Pipeline.for_part(env.part.model, env.workspace), frames


def _bits(pipeline: Pipeline, frame: Frame) -> bytes:
    seen = pipeline.perceive(frame)
    values = [value for pose in seen.poses for value in (pose.T_cam_part, np.float64(pose.score))]
    groups = [segment.point_idx for segment in seen.segments]
    return b"".join(np.ascontiguousarray(array).tobytes() for array in (*values, *groups, seen.boundary.points_cam))
