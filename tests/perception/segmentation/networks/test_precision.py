"""bfloat16 is used where it is wanted and fast, and nowhere else."""

import pytest
import torch

from perception.segmentation.networks.precision import bfloat16_is_fast, half_precision

CPU = torch.device("cpu")


@pytest.mark.parametrize(("avx", "amx", "fast"), [(True, False, True), (False, True, True), (False, False, False)])
def test_a_processor_without_the_instructions_stays_in_float32(
    avx: bool, amx: bool, fast: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: avx)
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: amx)
    assert bfloat16_is_fast(CPU) is fast
    with half_precision(CPU, wanted=True):
        assert torch.is_autocast_enabled("cpu") is fast
    with half_precision(CPU, wanted=False):
        assert not torch.is_autocast_enabled("cpu")


def test_other_devices_are_not_guessed_at() -> None:
    assert not bfloat16_is_fast(torch.device("meta"))
