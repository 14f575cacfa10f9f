"""Work on an index that reads or writes files, and may be computed on a machine that does not have them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

from perception.runtime.files import make_folder_atomically, write_bytes_atomically

Result = TypeVar("Result")
# Maps work over indices, in any order and any process, as `map` and binpick_env.jobs.map_indices do. The latter also
# computes on clusters, where work that writes files is a FolderWork, and work that reads large ones an InputWork.
Run = Callable[[Callable[[int], Result], Sequence[int]], Iterator[Result]]


@dataclass(frozen=True)
class FolderWork(Generic[Result]):
    """Work on an index that writes files into a folder.

    A node of a cluster computes it in a folder of its own, whose files are then brought to ``folder``. The work must
    therefore need nothing in the folder, and its result must not name it.

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
        """Write files, given by their paths in the folder, each atomically and in this order.

        A folder that is not there yet appears with all of its files at once, in place of the last of them.
        """
        wholes: dict[Path, dict[Path, bytes]] = {}  # files by what appears at once: a new folder, or a file
        for path, content in ((self.folder / name, content) for name, content in files.items()):
            whole = self._new_folder(path) or path
            wholes[whole] = {**wholes.pop(whole, {}), path: content}
        for whole, contents in wholes.items():
            inside = {path.relative_to(whole): content for path, content in contents.items()}
            if whole in contents or not make_folder_atomically(whole, partial(_write_files, inside)):
                _write_files(inside, whole)  # a file, or a folder that another process has made by now

    def _new_folder(self, path: Path) -> Path | None:
        """Return the outermost folder around a path that is missing in the folder; None if all are there."""
        around = [each for each in path.parents if each.is_relative_to(self.folder) and each != self.folder]
        return next((each for each in reversed(around) if not each.exists()), None)


@dataclass(frozen=True)
class InputWork(Generic[Result]):
    """Work on an index that reads files of its own, which are too large for every node of a cluster to have them all.

    A node gets the files of an index with this index, and removes them when it is computed. Whoever reads one asks
    :func:`perception.runtime.job_files.local_file` where it lies.

    Attributes:
        work: Function of an index, which may be a :class:`FolderWork`; it is picklable.
        inputs: Files that are read for each index.
    """

    work: Callable[[int], Result]
    inputs: Mapping[int, Sequence[Path]]

    def __call__(self, index: int) -> Result:
        """Work on ``index`` where the files are."""
        return self.work(index)


def without_inputs(work: Callable[[int], Result]) -> tuple[Callable[[int], Result], Mapping[int, Sequence[Path]]]:
    """Return what is left of work without the files of its indices, and these files."""
    return (work.work, work.inputs) if isinstance(work, InputWork) else (work, {})


def _write_files(files: Mapping[Path, bytes], folder: Path) -> None:
    """Write files, given by their paths in a folder; the path of the folder itself is empty."""
    for path, content in files.items():
        write_bytes_atomically(folder / path, content)
