"""Work whose results are files in a folder, which may be another one than that in which they are kept."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from perception.runtime.files import write_bytes_atomically

Result = TypeVar("Result")


@dataclass(frozen=True)
class FolderWork(Generic[Result]):
    """Work on an index that writes files into a folder.

    A node of a cluster computes it in a folder of its own, whose files are then brought to ``folder``. The work must
    therefore read nothing in the folder, and its result must not name it.

    Attributes:
        function: Takes a folder and an index, writes files into the folder and returns a result; it is picklable.
        folder: Folder that the files are kept in.
    """

    function: Callable[[Path, int], Result]
    folder: Path

    def __call__(self, index: int) -> Result:
        """Work on ``index`` in the folder."""
        return self.function(self.folder, index)

    def keep(self, files: Mapping[str, bytes]) -> None:
        """Write files, given by their paths in the folder, each atomically and in this order."""
        for name, content in files.items():
            write_bytes_atomically(self.folder / name, content)
