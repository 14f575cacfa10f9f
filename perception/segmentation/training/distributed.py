"""Training of a network by several processes: torch.distributed under torchrun."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import torch

PATIENCE = timedelta(hours=2)  # time that processes wait for the first one, which evaluates


@dataclass(frozen=True, kw_only=True)
class Place:
    """Place of this process among those that train together.

    Attributes:
        rank: Index among all processes.
        local_rank: Index among the processes of this machine.
        world: Number of processes.
    """

    rank: int = 0
    local_rank: int = 0
    world: int = 1


@contextmanager
def processes() -> Iterator[Place]:
    """Join the processes that torchrun started for the duration of the context; without torchrun, do nothing."""
    if not torch.distributed.is_torchelastic_launched():
        yield Place()
        return
    place = Place(
        rank=int(os.environ["RANK"]), local_rank=int(os.environ["LOCAL_RANK"]), world=int(os.environ["WORLD_SIZE"])
    )
    if torch.cuda.is_available():
        torch.cuda.set_device(place.local_rank)
    torch.distributed.init_process_group(timeout=PATIENCE)  # gloo for tensors on the CPU, nccl on a GPU
    try:
        yield place
    finally:
        torch.distributed.destroy_process_group()
