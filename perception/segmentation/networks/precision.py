"""Computation in bfloat16 on devices where it is fast."""

from contextlib import AbstractContextManager
from typing import Any

import torch


def half_precision(device: torch.device, wanted: bool) -> AbstractContextManager[Any]:
    """Return a context in which ``device`` computes in bfloat16 if ``wanted`` and if the device is fast at it."""
    return torch.autocast(device.type, torch.bfloat16, enabled=wanted and bfloat16_is_fast(device))


def bfloat16_is_fast(device: torch.device) -> bool:
    """Return whether the device has instructions for bfloat16; otherwise it is emulated, which is slow."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    return device.type == "cpu" and bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
