"""A node computes in folders of its own, with the files that came with the job."""

import os
import threading
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import pytest

from binpick_env.jobs import node
from binpick_env.jobs.build import build
from binpick_env.jobs.cluster_job import Job, Outcome, SentFile
from binpick_env.jobs.workers import WorkerError
from perception.runtime.file_work import FolderWork
from perception.runtime.job_files import JobFiles, local_file, resolved_path, use_job_files

started: list[str] = []
NO_FILES = JobFiles(start="/", files={}, weights=Path())


@pytest.fixture(autouse=True)
def fresh_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A node that has computed nothing; its working directory is another one than the job's."""
    (tmp_path / "node").mkdir()
    (tmp_path / "start").mkdir()
    monkeypatch.setattr(node.tempfile, "tempdir", str(tmp_path / "node"))
    monkeypatch.setattr(node, "_loaded", None)
    monkeypatch.setattr(node, "_begun", set())
    monkeypatch.chdir(tmp_path / "start")
    started.clear()
    yield tmp_path / "node" / f"binpick-node-{os.getuid()}"
    use_job_files(None)


def begin(name: str) -> None:
    started.append(name)


def read(path: str, index: int) -> tuple[int, bytes, str]:
    return index, local_file(Path(path)).read_bytes(), resolved_path(Path(path))


def write(folder: Path, index: int) -> str:
    (folder / "b").mkdir()
    (folder / "b" / "z.txt").write_text("first")
    os.utime(folder / "b" / "z.txt", (1, 1))
    (folder / "a.txt").write_text("last")
    return folder.name


def read_both(shared: str, own: list[str], index: int) -> tuple[bytes, bytes, str, list[str]]:
    """Return a file of the job, one of the index, its path, and what is there of those of all indices."""
    path = Path(own[index])
    there = [name for name in own if local_file(Path(name)).exists()]
    return local_file(Path(shared)).read_bytes(), local_file(path).read_bytes(), resolved_path(path), there


def fail_with_inputs(index: int) -> None:
    assert local_file(Path("room 0.npz")).exists()
    raise FloatingPointError("diverged")


def compute(job: Job, index: int, key: str = "job", inputs: Sequence[SentFile] = ()) -> Outcome:
    return node.compute(key, dict(build()), lambda: job, index, lambda: inputs)


def test_a_file_is_read_though_it_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = tmp_path / "start" / "gear.stl"
    original.write_bytes(b"a gear")
    job = Job.of(partial(read, "gear.stl"), begin, ("initialized",))
    original.unlink()
    monkeypatch.chdir("/")
    name = str(original.resolve())
    assert compute(job, 3).result == (3, b"a gear", name)
    assert node.compute("job", dict(build()), lambda: pytest.fail("the job is loaded"), 4).result[0] == 4
    assert started == ["initialized"]
    assert compute(job, 5, "a later job").result == (5, b"a gear", name)
    assert started == ["initialized", "initialized"]


def test_the_files_of_a_job_are_written_once_per_node(fresh_node: Path, tmp_path: Path) -> None:
    (tmp_path / "start" / "gear.stl").write_bytes(b"a gear")
    job = Job.of(partial(read, "gear.stl"), None, ())
    compute(job, 0)
    (copy,) = fresh_node.rglob("gear.stl")
    written = copy.stat().st_mtime_ns
    compute(job, 0, "another process")
    assert copy.stat().st_mtime_ns == written
    assert list(fresh_node.rglob(".*")) == []


def test_a_linked_file_keeps_the_name_that_it_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file without a suffix in a store, to which a link with one leads, is read by the link's name."""
    (tmp_path / "start" / "0123abcd").write_bytes(b"a gear")
    (tmp_path / "start" / "gear.stl").symlink_to("0123abcd")
    job = Job.of(partial(read_name, "gear.stl"), None, ())
    monkeypatch.chdir("/")
    assert compute(job, 0).result == ("gear.stl", b"a gear")


def read_name(path: str, index: int) -> tuple[str, bytes]:
    return local_file(Path(path)).name, local_file(Path(path)).read_bytes()


def test_copies_that_a_cleaner_has_removed_are_written_again(fresh_node: Path, tmp_path: Path) -> None:
    (tmp_path / "start" / "gear.stl").write_bytes(b"a gear")
    job = Job.of(partial(read, "gear.stl"), None, ())
    compute(job, 0)
    (copy,) = fresh_node.rglob("gear.stl")
    copy.unlink()
    assert compute(job, 1, "another process").result[:2] == (1, b"a gear")


@pytest.fixture
def sent_rooms(tmp_path: Path) -> list[SentFile]:
    """Two files that single indices read; they and a file of the job are gone when the job is computed."""
    for k in range(2):
        (tmp_path / "start" / f"room {k}.npz").write_bytes(b"room %d" % k)
    return [SentFile.read(Path(f"room {k}.npz")) for k in range(2)]


def test_the_files_of_an_index_are_there_for_it_alone(
    fresh_node: Path, tmp_path: Path, sent_rooms: list[SentFile], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "start" / "gear.stl").write_bytes(b"a gear")
    names = ["room 0.npz", "room 1.npz"]
    job = Job.of(partial(read_both, "gear.stl", names), None, (), map(Path, names))
    for path in (tmp_path / "start").iterdir():
        path.unlink()
    monkeypatch.chdir("/")
    for index in (0, 1, 0):
        path = str(tmp_path.resolve() / "start" / names[index])
        found = compute(job, index, inputs=[sent_rooms[index]]).result
        assert found == (b"a gear", b"room %d" % index, path, [names[index]])
        assert list((fresh_node / "drafts").iterdir()) == []
        assert local_file(Path(names[index])) == Path(names[index])


def test_the_files_of_an_index_that_fails_are_removed(fresh_node: Path, sent_rooms: list[SentFile]) -> None:
    with pytest.raises(FloatingPointError, match="diverged"):
        compute(Job.of(fail_with_inputs, None, ()), 0, inputs=sent_rooms)
    assert list((fresh_node / "drafts").iterdir()) == []
    assert local_file(Path("room 0.npz")) == Path("room 0.npz")


class _TwoArgumentsError(Exception):
    def __init__(self, code: int, text: str) -> None:
        super().__init__(f"{code}: {text}")


class _NoPickleError(Exception):
    def __reduce__(self) -> str:
        raise TypeError("not to be pickled")


@pytest.mark.parametrize(
    ("error", "kind", "text"),
    [
        (ValueError("a text"), ValueError, "^a text$"),
        (_TwoArgumentsError(3, "late"), WorkerError, "^the work failed: _TwoArgumentsError: 3: late$"),
        (_NoPickleError("here"), WorkerError, "^the work failed: _NoPickleError: here$"),
        (SystemExit("enough"), WorkerError, "^the work failed: SystemExit: enough$"),
    ],
)
def test_errors_of_the_work_arrive_or_are_told_in_words(error: BaseException, kind: type, text: str) -> None:
    def fail(index: int) -> None:
        raise error

    node._loaded = node._LoadedJob(key="job", name="fail", work=fail, files=NO_FILES)
    with pytest.raises(kind, match=text):
        node.compute("job", dict(build()), lambda: pytest.fail("it is loaded"), 0)


def test_what_was_written_comes_back_in_the_order_of_writing(fresh_node: Path, tmp_path: Path) -> None:
    outcome = compute(Job.of(FolderWork(write, tmp_path / "kept"), None, ()), 0)
    assert list(outcome.files.items()) == [("b/z.txt", b"first"), ("a.txt", b"last")]
    assert outcome.result != "kept"
    assert not (tmp_path / "kept").exists()
    assert list((fresh_node / "drafts").iterdir()) == []


def test_another_build_is_refused() -> None:
    job = Job.of(partial(read, ""), None, ())
    with pytest.raises(WorkerError, match=r"than this machine \(numpy: 0.1, .*\): install the same one on every node"):
        node.compute("job", {**build(), "numpy": "0.1"}, lambda: job, 0)


class _Reader:
    def __init__(self, path: str, index: int) -> None:
        self._read, self._stopped = partial(read, path, index), SystemExit("enough")

    def read(self, wanted: bool) -> tuple[int, bytes, str]:
        if not wanted:
            raise self._stopped
        return self._read()


def test_an_object_is_made_of_a_job_and_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "start" / "gear.stl").write_bytes(b"a gear")
    job = Job.of(partial(_Reader, "gear.stl"), begin, ("initialized",))
    (tmp_path / "start" / "gear.stl").unlink()
    monkeypatch.chdir("/")
    made = node.NodeObject(build(), lambda: job, 3)
    for _ in range(2):
        assert made.call("read", [True]).result == (3, b"a gear", str(tmp_path.resolve() / "start" / "gear.stl"))
    assert started == ["initialized"]
    with pytest.raises(WorkerError, match=r"^the work failed: SystemExit: enough$"):
        made.call("read", [False])
    with pytest.raises(WorkerError, match=r"than this machine \(numpy: 0.1, .*\): install the same one on every node"):
        node.NodeObject({**build(), "numpy": "0.1"}, lambda: pytest.fail("the job is loaded"), 0)


def test_a_folder_of_another_user_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    user = os.getuid()
    monkeypatch.setattr(node.os, "getuid", lambda: user + 1)
    with pytest.raises(WorkerError, match=rf"binpick-node-{user + 1} on .* must belong to the user of the worker"):
        node.node_folder()


def test_folders_of_killed_workers_are_removed_and_those_of_others_stay_however_old(fresh_node: Path) -> None:
    killed, starting = (node.node_folder() / "drafts" / name for name in ("killed", "starting"))
    with node._draft_folder() as folder:
        for each in (killed, starting):
            each.mkdir()
        (killed / "lock").touch()
        for each in (killed, folder.parent):
            os.utime(each, (time.time() - 1_000_000,) * 2)
        compute(Job.of(abs, None, ()), -1)
        assert {path.name for path in (fresh_node / "drafts").iterdir()} == {folder.parent.name, "starting"}
        assert list(folder.iterdir()) == []


def test_files_of_jobs_that_have_not_run_for_a_month_are_removed(fresh_node: Path, tmp_path: Path) -> None:
    original = tmp_path / "start" / "gear.stl"
    kept = []
    for content in (b"old", b"new"):
        original.write_bytes(content)
        compute(Job.of(partial(read, "gear.stl"), None, ()), 0, key=content.decode())
        kept.append({path.name for path in (fresh_node / "inputs").iterdir()})
    (first,) = kept[0]
    os.utime(fresh_node / "inputs" / first, (0, 0))
    compute(Job.of(partial(read, "gear.stl"), None, ()), 0, key="new again")
    assert {path.name for path in (fresh_node / "inputs").iterdir()} == kept[1] - kept[0]
    # A worker that starts keeps the files of its job, however old they are.
    (second,) = kept[1] - kept[0]
    os.utime(fresh_node / "inputs" / second, (0, 0))
    assert compute(Job.of(partial(read, "gear.stl"), None, ()), 3, key="once more").result[:2] == (3, b"new")


def test_the_first_work_of_a_kind_is_computed_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    compiling, compiled = threading.Event(), threading.Event()
    order: list[str] = []

    def first() -> None:
        with node._compiled_once("kind"):
            compiling.set()
            compiled.wait(10)
            order.append("first")

    thread = threading.Thread(target=first)
    thread.start()
    assert compiling.wait(10)
    monkeypatch.setattr(node, "_begun", set())  # as in another process
    threading.Timer(0.05, compiled.set).start()
    with node._compiled_once("kind"):
        order.append("second")
    thread.join()
    assert order == ["first", "second"]
    assert node._begun == {"kind"}


def test_a_kind_that_failed_is_compiled_by_the_next_process(fresh_node: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FloatingPointError), node._compiled_once("kind"):
        raise FloatingPointError
    assert not [path for path in fresh_node.glob("compiled-*") if path.suffix != ".lock"]
    monkeypatch.setattr(node, "_begun", set())
    with node._compiled_once("kind"):
        pass
    assert [path for path in fresh_node.glob("compiled-*") if path.suffix != ".lock"]
