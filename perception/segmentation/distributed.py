"""Several processes that train one network: torch.distributed under torchrun."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch


@dataclass(frozen=True, kw_only=True)
class Place:
    """Which of the processes this is; alone, it is the first.

    Attributes:
        rank: Among all processes.
        local_rank: Among those of this machine.
    """

    rank: int = 0
    local_rank: int = 0


@contextmanager
def processes() -> Iterator[Place]:
    """Join the processes that torchrun started, if it did; afterwards leave them."""
    if "WORLD_SIZE" not in os.environ:
        yield Place()
        return
    place = Place(rank=int(os.environ["RANK"]), local_rank=int(os.environ.get("LOCAL_RANK", "0")))
    torch.distributed.init_process_group("nccl" if torch.cuda.is_available() else "gloo")
    try:
        yield place
    finally:
        torch.distributed.destroy_process_group()
