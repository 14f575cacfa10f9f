"""What is made of an evaluation's bins beside their records."""

import pickle
from pathlib import Path

import pytest

from policies.evaluation.jobs import Job
from policies.report.media import BinMedia
from policies.report.pictures import Album
from policies.report.recording import Recording
from policies.report.video import Film

pytest.importorskip("imageio_ffmpeg")


def kinds(media: BinMedia, index: int, folder: Path) -> list[type]:
    return [type(listener) for listener in media.listeners(index, folder)]


def test_only_the_first_bin_is_filmed_and_recorded(tmp_path: Path) -> None:
    media = BinMedia(video=tmp_path / "film.mp4", recording=tmp_path / "bin.rrd")
    assert [kinds(media, index, tmp_path) for index in range(2)] == [[Album, Film, Recording], [Album]]
    assert [media.needs_bin(index) for index in range(2)] == [True, False]


def test_nothing_is_made_that_is_not_asked_for(tmp_path: Path) -> None:
    assert kinds(BinMedia(pictures=False), 0, tmp_path) == []
    assert kinds(BinMedia(), 0, tmp_path) == [Album]
    assert not BinMedia().needs_bin(0)
    assert list(tmp_path.iterdir()) == []


def test_a_job_takes_media_to_its_workers(tmp_path: Path) -> None:
    job = pickle.loads(pickle.dumps(Job(out=tmp_path, listeners=BinMedia(video=tmp_path / "film.mp4"))))
    assert [type(listener) for listener in job.bin_listeners(0)] == [Album, Film]
    assert [job.must_compute(index) for index in range(2)] == [True, False]


def test_several_evaluations_share_no_film_and_no_recording(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a budget is three evaluations and films none; leave out --video"):
        BinMedia(video=tmp_path / "film.mp4").check(evaluations=3)
    with pytest.raises(ValueError, match="a budget records none; leave out --rerun"):
        BinMedia(recording=tmp_path / "bin.rrd").check(evaluations=3)
    BinMedia().check(evaluations=3)


def test_files_with_a_wrong_ending_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"must end in \.mp4, got 'film\.avi'"):
        BinMedia(video=Path("film.avi")).check()
    with pytest.raises(ValueError, match=r"must end in \.rrd, got 'bin\.mp4'"):
        BinMedia(recording=Path("bin.mp4")).check()
    BinMedia(video=tmp_path / "film.mp4", recording=tmp_path / "bin.rrd").check()
    assert list(tmp_path.iterdir()) == []
