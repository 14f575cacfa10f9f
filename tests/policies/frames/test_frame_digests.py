"""Digests tell whether any of the files of a frame changed."""

from pathlib import Path

import pytest

from policies.frames import FrameSource
from policies.frames.frame_digests import changes


@pytest.mark.parametrize("name", ["depth.png", "depth_grey.png", "lens.json"])
def test_a_file_that_changes_is_named(tmp_path: Path, name: str) -> None:
    roles = {"depth.png": "frame", "depth_grey.png": "grey image", "lens.json": "calibration"}
    for file in roles:
        (tmp_path / file).write_text("before")
    source = FrameSource(grey=f"{tmp_path}/{{stem}}_grey.png", calibration=tmp_path / "lens.json")
    before = source.digests(tmp_path / "depth.png")
    assert changes(before, source.digests(tmp_path / "depth.png")) is None
    (tmp_path / name).write_text("after!")
    text = f"{roles[name]} changed since its results were written"
    assert changes(before, source.digests(tmp_path / "depth.png")) == text
    (tmp_path / name).unlink()
    assert changes(before, source.digests(tmp_path / "depth.png")) == text


def test_a_recordings_folder_has_the_digest_of_its_files(tmp_path: Path) -> None:
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell" / "metadata.yaml").write_text("one")
    before = FrameSource().digests(tmp_path / "cell")
    (tmp_path / "cell" / "cell.db3").write_text("two")
    assert changes(before, FrameSource().digests(tmp_path / "cell")) == "frame changed since its results were written"


def test_results_without_digests_are_not_taken() -> None:
    assert changes(None, {"frame": "a"}) == "its results do not say which files they are of"


def test_a_json_file_that_names_no_file_beside_it_has_a_digest_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"depth": "other/b.png", "grey": "", "K": []}')
    assert list(FrameSource().digests(tmp_path / "a.json")) == ["frame"]
