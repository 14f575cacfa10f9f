"""A job takes along the files that it names, and nothing else."""

import pickle
from functools import partial
from pathlib import Path

import pytest

from binpick_env.jobs.cluster_job import Job, SentFile
from binpick_env.scenes.synthesis import SceneConfig
from perception.runtime.file_work import FolderWork


def work(config: object, folder: Path, index: int) -> int:
    return index


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory: a part, a link to it, a network, and files that no job names."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "gear.stl").write_bytes(b"a gear")
    (tmp_path / "link.stl").symlink_to(tmp_path / "parts" / "gear.stl")
    (tmp_path / "net.safetensors").write_bytes(b"a network")
    (tmp_path / "other.stl").write_bytes(b"another part")
    (tmp_path / "tee").write_bytes(b"no part, though it has a part's name")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    return tmp_path


def test_files_travel_whether_they_are_named_by_a_text_or_a_path(start: Path) -> None:
    given = {"scenes": SceneConfig(part="parts/gear.stl"), "weights": start / "net.safetensors", "name": "tee"}
    job = Job.of(FolderWork(partial(work, given), start / "out"), None, ())
    gear, net = str(start.resolve() / "parts" / "gear.stl"), str(start.resolve() / "net.safetensors")
    assert {file.names: file.content for file in job.files} == {(gear, gear): b"a gear", (net, net): b"a network"}
    assert job.start == str(start.resolve())


def test_a_link_is_known_by_both_names(start: Path) -> None:
    (file,) = Job.of(partial(work, "link.stl"), None, ()).files
    assert file.names == (str(start.resolve() / "link.stl"), str(start.resolve() / "parts" / "gear.stl"))


def test_what_the_initializer_names_travels_too(start: Path) -> None:
    job = Job.of(partial(work, "x" * 5000 + ".stl"), print, ("other.stl",))
    assert [file.content for file in job.files] == [b"another part"]
    assert pickle.loads(job.work)[1:] == (print, ("other.stl",))


def test_installed_weights_travel_by_their_names(start: Path) -> None:
    assert Job.of(work, None, ()).weights == {}  # type: ignore[arg-type]
    (start / "cache" / "weights").mkdir(parents=True)
    (start / "cache" / "weights" / "tee.safetensors").write_bytes(b"tee")
    assert Job.of(work, None, ()).weights == {"tee.safetensors": b"tee"}  # type: ignore[arg-type]


def test_a_job_has_the_name_of_its_function(start: Path) -> None:
    whole = FolderWork(partial(partial(work, 1)), start)
    assert Job.of(whole, None, ()).name == f"{__name__}.work"


def test_files_of_single_indices_do_not_travel_with_the_job(start: Path) -> None:
    named = partial(work, ["parts/gear.stl", "other.stl"])
    (file,) = Job.of(named, None, (), [start / "link.stl"]).files  # a link to the gear
    assert file.content == b"another part"


def test_jobs_with_other_files_have_other_digests(start: Path) -> None:
    first = Job.of(partial(work, "other.stl"), None, ())
    assert Job.of(partial(work, "other.stl"), print, ()).digest == first.digest
    (start / "other.stl").write_bytes(b"a new part")
    assert Job.of(partial(work, "other.stl"), None, ()).digest != first.digest


@pytest.mark.parametrize("protocol", [4, 5])
def test_a_file_is_pickled_with_all_that_it_holds(start: Path, protocol: int) -> None:
    file = SentFile.read(start / "other.stl")
    assert pickle.loads(pickle.dumps(file, protocol)) == file


def test_the_content_of_a_file_can_be_kept_in_shared_memory(start: Path) -> None:
    shared: list[pickle.PickleBuffer] = []
    file = SentFile.read(start / "other.stl")
    pickled = pickle.dumps(file, 5, buffer_callback=shared.append)
    assert b"another part" not in pickled
    assert [bytes(each) for each in shared] == [b"another part"]
    assert bytes(pickle.loads(pickled, buffers=shared).content) == b"another part"
