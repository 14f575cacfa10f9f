"""On a node, those who open a file find the copy that came with the job, and everybody else the path."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.evaluation.segmentation.method import MethodConfig
from binpick_env.parts.label import part_label
from binpick_env.parts.part import load_part
from perception.runtime.job_files import JobFile, JobFiles, find_files, local_file, resolved_path, use_job_files
from perception.runtime.records import RecordFormat
from perception.segmentation.weights import user_folder
from policies.evaluation.config import EvaluationConfig
from policies.selection.selectors import selector_path

FORMAT = RecordFormat(kind="list", version=1, remedy="make it again")
Send = Callable[[str], Path]


@pytest.fixture
def send(tmp_path: Path) -> Iterator[Send]:
    """A function that makes the copy of a file of another machine, where it lies in ~/job, a link to ~/data."""
    files: dict[str, JobFile] = {}
    (tmp_path / "node").mkdir()

    def sent(name: str) -> Path:
        copy = tmp_path / "node" / name
        files[f"/home/ada/job/{name}"] = files[f"/data/{name}"] = JobFile(resolved=f"/data/{name}", copy=copy)
        return copy

    use_job_files(JobFiles(start="/home/ada/job", files=files, weights=tmp_path / "weights"))
    yield sent
    use_job_files(None)


@pytest.mark.parametrize("path", ["a.stl", "./b/../a.stl", "/home/ada/job/a.stl", "../../ada/job/a.stl", "/data/a.stl"])
def test_a_copy_is_found_by_every_name_of_the_file(send: Send, path: str) -> None:
    copy = send("a.stl")
    assert local_file(Path(path)) == copy
    assert resolved_path(Path(path)) == "/data/a.stl"


def test_other_files_are_where_they_are(send: Send, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    send("a.stl")
    monkeypatch.chdir(tmp_path)
    assert local_file(Path("b.stl")) == Path("b.stl")
    assert resolved_path(Path("b.stl")) == str(tmp_path.resolve() / "b.stl")


@pytest.mark.parametrize("folder", ["rooms", "/home/ada/job/rooms", "../../ada/job/rooms"])
def test_the_files_of_a_folder_are_those_that_came(send: Send, folder: str) -> None:
    for name in (
        "rooms/b/2.npz",
        "rooms/b/1.npz",
        "rooms/a/3.npz",
        "rooms/b/c/4.npz",
        "rooms/b/5.txt",
        "other/a/6.npz",
    ):
        send(name)
    found = find_files(Path(folder), "*/*.npz")
    assert found == [Path(folder) / name for name in ("a/3.npz", "b/1.npz", "b/2.npz")]
    assert resolved_path(Path(folder)) == "/home/ada/job/rooms"
    assert find_files(Path("elsewhere"), "*/*.npz") == []


def test_without_a_job_the_files_of_a_folder_are_those_in_it(tmp_path: Path) -> None:
    for name in ("2.npz", "1.npz", "3.txt"):
        (tmp_path / name).touch()
    assert find_files(tmp_path, "*.npz") == [tmp_path / "1.npz", tmp_path / "2.npz"]


def test_without_a_job_paths_are_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link.stl").symlink_to("file.stl")
    assert local_file(Path("link.stl")) == Path("link.stl")
    assert resolved_path(Path("link.stl")) == str(tmp_path.resolve() / "file.stl")


def test_installed_weights_are_the_jobs(send: Send, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "own"))
    assert user_folder() == tmp_path / "weights"
    use_job_files(None)
    assert user_folder() == tmp_path / "own" / "weights"


def test_a_part_is_read_from_its_copy_and_named_by_its_path(send: Send) -> None:
    trimesh.creation.box((0.06, 0.04, 0.02)).export(send("block.stl"))
    content = hashlib.sha256(local_file(Path("block.stl")).read_bytes()).hexdigest()
    part = load_part("block.stl")
    assert (part.source, part.model.name) == ("/data/block.stl", "block")
    assert part_label("block.stl") == part_label(part.source) == f"block-{content[:8]}"
    config = EvaluationConfig(part="block.stl")
    digest = config.digest()
    use_job_files(None)
    assert config.digest() != digest  # there is no such file here


@pytest.mark.parametrize("layout", ["arrays", "plain", "tensors"])
def test_records_are_read_from_their_copies(send: Send, layout: str) -> None:
    copy, path = send("record.safetensors"), Path("record.safetensors")
    if layout == "arrays":
        FORMAT.save_arrays(copy, {"x": np.arange(3)})
        assert FORMAT.load_arrays(path, lambda arrays: arrays["x"].tolist()) == [0, 1, 2]
    elif layout == "plain":
        FORMAT.save_plain(copy, {"x": 3})
        assert FORMAT.load_plain(path, lambda values: values["x"]) == 3
    else:
        import torch

        FORMAT.save_tensors(copy, {"x": torch.ones(2)}, {"name": "one"})
        assert FORMAT.load_header(path)["name"] == "one"
        assert FORMAT.load_tensors(path, lambda header, tensors: tensors["x"].tolist()) == [1.0, 1.0]


def test_networks_are_read_from_their_copies(send: Send) -> None:
    send("net.safetensors").write_bytes(b"a network")
    method = MethodConfig(weights=Path("net.safetensors"))
    assert method.digest() == hashlib.sha256(b"a network").hexdigest()
    assert selector_path("net.safetensors") == Path("net.safetensors")
