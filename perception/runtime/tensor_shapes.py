"""Networks whose weights come from a file, which may say anything of their sizes."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from torch import Tensor, nn

Network = TypeVar("Network", bound="nn.Module")


def filled(make: "Callable[[], Network]", tensors: "Mapping[str, Tensor]") -> Network:
    """Return a network of single precision with the weights of a file.

    The sizes that the network would have are compared with those of the tensors before any memory is taken for it.

    Args:
        make: Builds the network, of the sizes that the file describes.
        tensors: Tensors of the file by name, of any precision.

    Raises:
        ValueError: The tensors are not those of the network.
    """
    import torch  # not at the top: importing torch takes a second

    with torch.device("meta"):
        needed = {name: tuple(tensor.shape) for name, tensor in make().state_dict().items()}
    held = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    for name in sorted({*needed, *held}):
        if needed.get(name) != held.get(name):
            raise ValueError(
                f"the network that it describes needs {_shown(needed.get(name))} for {name}, "
                f"it holds {_shown(held.get(name))}"
            )
    network = make().float()  # whatever torch's default type is in the caller's program
    network.load_state_dict(tensors)
    return network


def _shown(shape: tuple[int, ...] | None) -> str:
    return "nothing" if shape is None else f"a tensor of {shape}"
