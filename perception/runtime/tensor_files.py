"""Tensors in safetensors files that are whole or absent."""

from collections.abc import Mapping
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor

from perception.runtime.files import replace_atomically


def save_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: dict[str, str]) -> None:
    """Write named tensors, of any device, and words beside them in one piece.

    Raises:
        OSError: The file cannot be written; what stood there before is untouched.
    """
    whole = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}

    def write(draft: Path) -> None:
        save_file(whole, draft, metadata=metadata)
        draft.chmod(0o644)  # others on this machine may read it, as any file

    try:
        replace_atomically(path, write)
    except SafetensorError as error:  # no OSError, though a full disk is behind it
        raise OSError(f"{path} cannot be written ({error})") from error
