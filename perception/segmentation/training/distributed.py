"""Several processes that train one network: torch.distributed under torchrun."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import torch

PATIENCE = timedelta(hours=2)  # of the processes that wait while the first one evaluates


@dataclass(frozen=True, kw_only=True)
class Place:
    """Which of the processes this is; alone, it is the first.

    Attributes:
        rank: Among all processes.
        local_rank: Among those of this machine.
        world: How many there are.
    """

    rank: int = 0
    local_rank: int = 0
    world: int = 1


@contextmanager
def processes() -> Iterator[Place]:
    """Join the processes that torchrun started, if it did; afterwards leave them."""
    if not torch.distributed.is_torchelastic_launched():
        yield Place()
        return
    place = Place(
        rank=int(os.environ["RANK"]), local_rank=int(os.environ["LOCAL_RANK"]), world=int(os.environ["WORLD_SIZE"])
    )
    if torch.cuda.is_available():
        torch.cuda.set_device(place.local_rank)
    torch.distributed.init_process_group(timeout=PATIENCE)  # gloo for tensors of the processor, nccl for a GPU's
    try:
        yield place
    finally:
        torch.distributed.destroy_process_group()
