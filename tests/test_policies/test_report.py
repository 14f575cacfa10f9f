import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from fake_cell import abstain, attempt, bin_result, frame, grasp

from binpick_env.report_style import tile
from policies.evaluation import EvaluationConfig
from policies.outcomes import GraspOutcome, PickResult
from policies.pictures import CROP_PX, Album, grasp_picture
from policies.records import BinRecord
from policies.report import GALLERY_LIMIT, write_report
from policies.summary import summarise

CONFIG = EvaluationConfig(part="odd <&> name.stl")
MISSED, DELIVERED = GraspOutcome.MISSED, GraspOutcome.DELIVERED
_VOID = {"meta", "img"}


class Balance(HTMLParser):
    """Fails on a tag that closes nothing; HTMLParser is only to be had by inheritance."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture
def report(tmp_path: Path) -> Callable[..., str]:
    def write(*picks: PickResult, pictures: bool = True) -> str:
        album = Album(tmp_path if pictures else None, "bin_0000")
        names = [album.failure(frame(), pick, k) if pick.outcome is MISSED else "" for k, pick in enumerate(picks)]
        facts = {"config_hash": CONFIG.digest(), "index": 0, "wall": 9.0, "settle": 1.0, "render": 1.0}
        records = [BinRecord.from_result(bin_result(*picks), names, **facts)]
        summary = summarise(records, CONFIG, np.random.default_rng(0))
        write_report(tmp_path / "report.html", summary, records, tmp_path)
        return (tmp_path / "report.html").read_text()

    return write


def test_the_page_is_whole_and_needs_nothing_else(report: Callable[..., str]) -> None:
    text = report(attempt(DELIVERED), attempt(MISSED), abstain())
    balance = Balance()
    balance.feed(text)
    assert balance.open == []
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)
    assert re.findall(r"src='(data:image/jpeg;base64,)", text)


def test_the_page_shows_numbers_attempts_and_failures(report: Callable[..., str]) -> None:
    text = report(attempt(DELIVERED), attempt(MISSED), abstain())
    for part in ("50.0 %", "1 of 2 attempts", "3 decisions", "30.0", "no candidate", "odd &lt;&amp;&gt; name.stl"):
        assert part in text


def test_the_page_stands_without_pictures_and_without_attempts(report: Callable[..., str]) -> None:
    assert "data:image" not in report(attempt(MISSED), pictures=False)
    assert "Failures</h2><p>None.</p>" in report(abstain(), abstain())


def test_the_gallery_is_limited(report: Callable[..., str]) -> None:
    text = report(*[attempt(MISSED)] * (GALLERY_LIMIT + 5))
    assert text.count("<figure>") == GALLERY_LIMIT
    assert f"{GALLERY_LIMIT} of {GALLERY_LIMIT + 5} failures" in text


def test_a_missing_picture_is_said(report: Callable[..., str], tmp_path: Path) -> None:
    report(attempt(MISSED))
    facts = {"config_hash": CONFIG.digest(), "index": 0, "wall": 9.0, "settle": 1.0, "render": 1.0}
    records = [BinRecord.from_result(bin_result(attempt(MISSED)), ["gone.jpg"], before="a.jpg", after="b.jpg", **facts)]
    write_report(tmp_path / "r.html", summarise(records, CONFIG, np.random.default_rng(0)), records, tmp_path)
    assert (tmp_path / "r.html").read_text().count("no picture") == 3


def test_the_interval_is_drawn_to_scale() -> None:
    assert "left:25.00%;width:50.00%" in tile("x", "50 %", "", (0.25, 0.75, 0.5))


def test_the_jaw_is_drawn_where_it_was() -> None:
    # The grasp's y axis is the world's -y, which is down in the image; pads at 15 mm open to 25 mm from the centre.
    picture = grasp_picture(frame(), grasp(width=0.03, opening=0.05)).astype(int)
    assert picture.shape == (CROP_PX, CROP_PX, 3)
    orange = picture[:, :, 2] > picture[:, :, 0] + 60
    rows = np.flatnonzero(orange.any(axis=1))
    millimetres = (rows - CROP_PX / 2) / CROP_PX * 170
    assert millimetres[[0, -1]] == pytest.approx([-25.0, 25.0], abs=1.5)
    columns = np.flatnonzero(orange.any(axis=0))
    assert (columns[[0, -1]] - CROP_PX / 2) / CROP_PX * 170 == pytest.approx([-11.0, 11.0], abs=1.5)


def test_an_album_without_a_folder_keeps_nothing() -> None:
    album = Album(None, "bin")
    assert album.failure(frame(), attempt(MISSED), 0) == ""
    assert album.overview(SimpleNamespace(), "before") == ""  # type: ignore[arg-type]
    assert album.seconds == 0.0


def test_an_album_writes_what_opencv_reads(tmp_path: Path) -> None:
    name = Album(tmp_path / "new", "bin_0007").failure(frame(), attempt(MISSED), 4)
    assert name == "bin_0007_pick_04.jpg"
    picture = cv2.imread(str(tmp_path / "new" / name))
    assert picture is not None
    assert picture.shape == (CROP_PX, CROP_PX, 3)
