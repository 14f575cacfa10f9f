"""Networks whose weights come from a file."""

from collections.abc import Callable

import pytest
import torch
from torch import nn

from perception.runtime.tensor_shapes import filled

TENSORS = {"weight": torch.arange(6.0).reshape(2, 3), "bias": torch.ones(2)}


def test_a_network_takes_the_tensors_of_a_file() -> None:
    network = filled(lambda: nn.Linear(3, 2), TENSORS)
    assert all(torch.equal(value, TENSORS[name]) for name, value in network.state_dict().items())


def test_tensors_of_half_precision_become_single() -> None:
    network = filled(lambda: nn.Linear(3, 2), {name: value.half() for name, value in TENSORS.items()})
    assert {value.dtype for value in network.state_dict().values()} == {torch.float32}


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: nn.Linear(4, 2), r"needs a tensor of \(2, 4\) for weight, it holds a tensor of \(2, 3\)"),
        (lambda: nn.Linear(3, 2, bias=False), r"needs nothing for bias, it holds a tensor of \(2,\)"),
        (lambda: nn.BatchNorm1d(2), r"needs a tensor of \(\) for num_batches_tracked, it holds nothing"),
        (lambda: nn.Linear(10**7, 10**7), r"needs a tensor of \(10000000,\) for bias"),  # 400 TB, never taken
    ],
)
def test_other_tensors_than_the_networks_are_refused(make: Callable[[], nn.Module], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        filled(make, TENSORS)
