from functools import partial
from pathlib import Path

from perception.runtime.file_work import FolderWork


def double(folder: Path, index: int) -> int:
    (folder / f"{index}.txt").write_text("here")
    return 2 * index


def test_here_the_work_writes_into_the_folder_itself(tmp_path: Path) -> None:
    assert FolderWork(double, tmp_path)(21) == 42
    assert (tmp_path / "21.txt").read_text() == "here"


def test_files_from_elsewhere_replace_those_in_the_folder(tmp_path: Path) -> None:
    work = FolderWork(partial(double), tmp_path / "new")
    work.keep({"a/b.bin": b"\0\1", "c.txt": b"first"})
    work.keep({"c.txt": b"second"})
    found = {str(path.relative_to(tmp_path)): path.read_bytes() for path in tmp_path.rglob("*.*")}
    assert found == {"new/a/b.bin": b"\0\1", "new/c.txt": b"second"}
