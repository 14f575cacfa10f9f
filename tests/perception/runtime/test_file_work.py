"""Files of work arrive whole and in order, wherever it was computed."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from perception.runtime import file_work
from perception.runtime.file_work import FolderWork, InputWork, without_inputs


def double(folder: Path, index: int) -> int:
    (folder / f"{index}.txt").write_text("here")
    return 2 * index


def names_in(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def before_writing(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[Path], None]], None]:
    """A function that lets another one be called with the path of each file before it is written."""

    def watch(look: Callable[[Path], None]) -> None:
        write = file_work.write_bytes_atomically

        def watched(path: Path, content: bytes) -> None:
            look(path)
            write(path, content)

        monkeypatch.setattr(file_work, "write_bytes_atomically", watched)

    return watch


def test_here_the_work_writes_into_the_folder_itself(tmp_path: Path) -> None:
    assert FolderWork(double, tmp_path)(21) == 42
    assert (tmp_path / "21.txt").read_text() == "here"


def test_files_from_elsewhere_replace_those_in_the_folder(tmp_path: Path) -> None:
    work = FolderWork(partial(double), tmp_path / "new")
    work.keep({"a/b.bin": b"\0\1", "c.txt": b"first"})
    work.keep({"c.txt": b"second"})
    found = {str(path.relative_to(tmp_path)): path.read_bytes() for path in tmp_path.rglob("*.*")}
    assert found == {"new/a/b.bin": b"\0\1", "new/c.txt": b"second"}


def test_a_new_folder_appears_whole_in_place_of_its_last_file(
    tmp_path: Path, before_writing: Callable[[Callable[[Path], None]], None]
) -> None:
    (tmp_path / "old").mkdir()
    seen: list[tuple[str, set[str]]] = []
    before_writing(lambda path: seen.append((path.name, {n for n in names_in(tmp_path) if not n.startswith(".")})))
    names = ("new/deep/1", "old/2", "new/3", "4")
    FolderWork(double, tmp_path).keep({name: name.encode() for name in names})
    assert seen == [
        ("2", set()),
        ("1", {"old/2"}),
        ("3", {"old/2"}),
        ("4", {"old/2", "new/deep/1", "new/3"}),
    ]
    assert {name: (tmp_path / name).read_text() for name in names_in(tmp_path)} == {name: name for name in names}


def test_of_a_folder_that_arrives_in_part_nothing_is_left(
    tmp_path: Path, before_writing: Callable[[Callable[[Path], None]], None]
) -> None:
    def fail(path: Path) -> None:
        if path.name == "2":
            raise KeyboardInterrupt

    before_writing(fail)
    with pytest.raises(KeyboardInterrupt):
        FolderWork(double, tmp_path).keep({"Area_1/office/1": b"", "Area_1/office/2": b""})
    assert list(tmp_path.iterdir()) == []


def test_files_arrive_in_a_folder_that_another_process_makes_meanwhile(
    tmp_path: Path, before_writing: Callable[[Callable[[Path], None]], None]
) -> None:
    def make(path: Path) -> None:
        (tmp_path / "new").mkdir(exist_ok=True)
        (tmp_path / "new" / "theirs").touch()

    before_writing(make)
    FolderWork(double, tmp_path).keep({"new/ours": b"ours"})
    assert names_in(tmp_path) == {"new/theirs", "new/ours"}


def test_inputs_are_no_matter_where_the_files_are() -> None:
    work = InputWork(abs, {-3: [Path("a")]})
    assert work(-3) == 3
    assert without_inputs(work) == (abs, {-3: [Path("a")]})
    assert without_inputs(abs) == (abs, {})
