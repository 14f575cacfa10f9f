"""A file is whole or absent, whatever happens while it is written."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from perception.runtime.files import (
    json_text,
    make_folder_atomically,
    replace_atomically,
    write_atomically,
    write_bytes_atomically,
)

ROOT = Path(__file__).parents[3]


def test_nan_becomes_null_however_deep() -> None:
    values = {"a": float("nan"), "b": [1.5, (np.float64("nan"), "x")], "c": {"d": None, "e": True}}
    assert json.loads(json_text(values)) == {"a": None, "b": [1.5, [None, "x"]], "c": {"d": None, "e": True}}


def test_infinity_is_no_json() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_text({"a": float("inf")})


def test_a_file_is_written_with_its_folders_and_no_draft_is_left(tmp_path: Path) -> None:
    path = tmp_path / "new" / "deep" / "note.txt"
    write_atomically(path, "one")
    write_atomically(path, "two")
    assert path.read_text() == "two"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [OSError("No space left on device"), KeyboardInterrupt()])
def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "note.txt"
    path.write_text("old")

    def half(draft: Path) -> None:
        draft.write_text("ne")
        assert path.read_text() == "old"  # nobody meets the draft under the file's name
        raise error

    with pytest.raises(type(error)):
        replace_atomically(path, half)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_bytes_are_written_likewise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "new" / "picture.png"
    write_bytes_atomically(path, b"one")
    monkeypatch.setattr(Path, "write_bytes", lambda self, content: no_space())
    with pytest.raises(OSError, match=r"No space left on device: '.*/picture\.png'$"):
        write_bytes_atomically(path, b"two")
    assert path.read_bytes() == b"one"
    assert list(path.parent.iterdir()) == [path]


def no_space() -> int:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("filename", [None, "draft"])
def test_an_error_of_the_disk_names_the_file(tmp_path: Path, filename: str | None) -> None:
    def write(draft: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", filename and str(draft))

    with pytest.raises(OSError, match=r"No space left on device: '.*/numbers\.json'$") as raised:
        replace_atomically(tmp_path / "numbers.json", write)
    assert raised.value.errno == errno.ENOSPC


def test_text_is_utf_8_whatever_the_locale(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from perception.runtime.files import write_atomically; "
        r"write_atomically(Path(sys.argv[1]), 'Geh\u00e4use \u00b7 \u2550')"
    )
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "page.html")], cwd=ROOT, env=os.environ | ascii_only, check=True
    )
    assert (tmp_path / "page.html").read_bytes() == "Gehäuse · ═".encode()


def test_the_name_of_a_file_in_another_encoding_can_be_written(tmp_path: Path) -> None:
    name = os.fsdecode(b"W\xednkel.stl")
    write_atomically(tmp_path / "page.html", f"the part {name}")
    assert (tmp_path / "page.html").read_text(encoding="utf-8") == "the part W?nkel.stl"


def test_a_writer_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        replace_atomically(tmp_path / "note.txt", lambda draft: None)
    assert list(tmp_path.iterdir()) == []


def test_drafts_that_killed_processes_left_are_removed(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
    left = tmp_path / f".numbers[1].json.{ended.pid}"
    kept = [
        tmp_path / f".numbers[1].json.{os.getppid()}",  # of a process that runs
        tmp_path / f".other.json.{ended.pid}",
        tmp_path / ".numbers[1].json.backup",
    ]
    for path in (left, *kept):
        path.touch()
        os.utime(path, (0, 0))
    fresh = tmp_path / f".numbers[1].json.{ended.pid + 1000000}"  # of a process of another machine, perhaps
    fresh.touch()
    write_atomically(tmp_path / "numbers[1].json", "{}")
    assert {path.name for path in tmp_path.iterdir()} == {"numbers[1].json", fresh.name, *(path.name for path in kept)}


# --- folders ---------------------------------------------------------------------------------------------------------


def test_a_folder_appears_with_everything_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "room"

    def write(draft: Path) -> None:
        (draft / "a.txt").write_text("a")
        assert not folder.exists()

    assert make_folder_atomically(folder, write)
    assert [path.name for path in folder.parent.rglob("*")] == ["room", "a.txt"]


@pytest.mark.parametrize("error", [OSError("No space left on device"), KeyboardInterrupt()])
def test_of_a_folder_that_fails_nothing_is_left(tmp_path: Path, error: BaseException) -> None:
    def half(draft: Path) -> None:
        (draft / "a.txt").write_text("a")
        raise error

    with pytest.raises(type(error)):
        make_folder_atomically(tmp_path / "room", half)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_there_stays_and_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "theirs").touch()
    (tmp_path / "file").touch()
    assert not make_folder_atomically(tmp_path / "room", lambda draft: (draft / "ours").touch())
    with pytest.raises(NotADirectoryError):
        make_folder_atomically(tmp_path / "file", lambda draft: None)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "room", "theirs"]


def test_drafts_of_folders_that_killed_processes_left_are_removed_unless_they_are_written_now(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
    drafts = [tmp_path / f".room.{ended.pid + offset}" for offset in (0, 1_000_000)]
    for draft in (*drafts, tmp_path / f".room.{os.getpid()}"):  # this process has the number of one that was killed
        draft.mkdir()
        (draft / "a.txt").touch()
        os.utime(draft / "a.txt", (0, 0))
        os.utime(draft, (0, 0))
    os.utime(drafts[1] / "a.txt")  # of a process of another machine, perhaps
    assert make_folder_atomically(tmp_path / "room", lambda draft: None)
    assert {path.name for path in tmp_path.iterdir()} == {"room", drafts[1].name}
    assert list((tmp_path / "room").iterdir()) == []
