"""Records: files with a kind and a version, written atomically in one of three layouts.

- Arrays: NPZ; ``kind`` and ``version`` are arrays of one value.
- Tensors: safetensors; a JSON header ``record`` holds ``version`` and every other plain value.
- Plain values: JSON with ``kind`` and ``version``.

Older files name no kind, which is accepted, and some name no version, which means version 1.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from perception.runtime.array_files import load_npz, require_bytes
from perception.runtime.files import json_text, replace_atomically, write_atomically
from perception.runtime.job_files import local_file

if TYPE_CHECKING:
    from torch import Tensor

T = TypeVar("T")
FIRST_VERSION = 1  # version of a file that names none
_HEADERS = ("record", "training")  # names of the header in a safetensors file; checkpoints once used the second


class RecordError(ValueError):
    """A file does not hold a whole record of the required kind and version."""


@dataclass(frozen=True, kw_only=True)
class RecordFormat:
    """One kind of record, and how its files are written and read.

    Attributes:
        kind: Noun phrase for what a file holds, such as "pose record". It is stored in the file.
        version: The version that is written, and the only one that is read. Raise it when a field changes its meaning.
        remedy: What a user can do about a file that cannot be read, as an imperative clause.
        error: Exception that such a file raises.
    """

    kind: str
    version: int
    remedy: str
    error: type[RecordError] = RecordError

    def save_arrays(self, path: Path, arrays: Mapping[str, Any], *, compressed: bool = True) -> None:
        """Write arrays, numbers and text as NPZ, atomically."""
        whole = {"kind": np.str_(self.kind), "version": np.int64(self.version), **arrays}
        save = np.savez_compressed if compressed else np.savez

        def write(draft: Path) -> None:
            with draft.open("wb") as file:  # given a name, NumPy would append .npz to it
                save(file, allow_pickle=False, **whole)

        replace_atomically(path, write)

    def load_arrays(self, path: Path, build: Callable[[dict[str, NDArray[Any]]], T]) -> T:
        """Return what ``build`` makes of the arrays of a file.

        Raises:
            RecordError: The file is missing, damaged or of another kind or version, or ``build`` fails.
        """
        with self._reading(path):
            arrays = load_npz(local_file(path))
            self._check(path, arrays)
            return build(arrays)

    def save_plain(self, path: Path, values: Mapping[str, Any], *, indent: int | None = 1) -> None:
        """Write plain values as JSON, atomically; NaN becomes null.

        Args:
            path: File to write.
            values: Anything that JSON holds.
            indent: Spaces before a nested value; None writes a single line.
        """
        write_atomically(path, json_text({"kind": self.kind, "version": self.version, **values}, indent))

    def load_plain(self, path: Path, build: Callable[[dict[str, Any]], T]) -> T:
        """Return what ``build`` makes of the values of a JSON file, without kind and version.

        Raises:
            RecordError: The file is missing, damaged or of another kind or version, or ``build`` fails.
        """
        with self._reading(path):
            file = local_file(path)
            require_bytes(path.name, file.stat().st_size)
            values = json.loads(file.read_text(encoding="utf-8"))
            self._check(path, values)
            return build({name: value for name, value in values.items() if name not in ("kind", "version")})

    def save_tensors(self, path: Path, tensors: "Mapping[str, Tensor]", header: Mapping[str, Any]) -> str:
        """Write named tensors of any device and a header as safetensors, atomically.

        Args:
            path: File to write.
            tensors: Tensors by name.
            header: Anything that JSON holds.

        Returns:
            The header as JSON, version included.

        Raises:
            OSError: The file cannot be written; a previous one stays as it was.
        """
        from safetensors.torch import save_file  # not at the top: importing torch takes a second

        text = json_text({"version": self.version, **header})
        whole = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}

        def write(draft: Path) -> None:
            save_file(whole, draft, metadata={"kind": self.kind, "record": text})
            draft.chmod(0o644)  # safetensors makes files that nobody else may read

        try:
            replace_atomically(path, write)
        except SafetensorError as error:  # no OSError, though a full disk is behind it
            raise OSError(f"{path} cannot be written ({error})") from error
        return text

    def load_header(self, path: Path) -> dict[str, Any]:
        """Return the header of a safetensors file, version included; tensors are not read.

        Raises:
            RecordError: The file is missing, damaged or of another kind or version.
        """
        with self._reading(path), safe_open(local_file(path), framework="numpy") as file:
            metadata = file.metadata() or {}
            text = next((metadata[name] for name in _HEADERS if name in metadata), None)
            if text is None:
                raise ValueError("it has no header")
            header: dict[str, Any] = json.loads(text)
            version = header.get("version", FIRST_VERSION)
            self._check(path, {"kind": metadata.get("kind", self.kind), "version": version})
            return header

    def load_tensors(self, path: Path, build: "Callable[[dict[str, Any], dict[str, Tensor]], T]") -> T:
        """Return what ``build`` makes of the header and the tensors of a safetensors file.

        Raises:
            RecordError: The file is missing, damaged or of another kind or version, or ``build`` fails.
        """
        from safetensors.torch import load_file

        header = self.load_header(path)
        with self._reading(path):
            file = local_file(path)
            require_bytes(path.name, file.stat().st_size)
            return build(header, load_file(file))

    def _check(self, path: Path, stored: Mapping[str, Any]) -> None:
        """Refuse a file of another kind or version."""
        kind = str(stored.get("kind", self.kind))
        if kind != self.kind:
            raise self.error(f"{path} must hold a {self.kind}, but it holds a {kind}; {self.remedy}")
        version = int(stored.get("version", FIRST_VERSION))
        if version != self.version:
            remedy = self.remedy if version < self.version else "update binpick, a newer one wrote it"
            raise self.error(f"{path} is a {self.kind} of version {version}, this code reads {self.version}; {remedy}")

    @contextmanager
    def _reading(self, path: Path) -> Iterator[None]:
        """Turn whatever goes wrong while ``path`` is read into this format's error."""
        try:
            yield
        except self.error:
            raise
        except Exception as error:  # a flipped bit draws nearly anything from zipfile, zlib, JSON and NumPy's headers
            reason = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            raise self.error(f"{path} does not hold a complete {self.kind} ({reason}); {self.remedy}") from error
