import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from binpick_env.jobs.report_style import tile
from binpick_env.observation.observed_candidates import ObservedCandidates
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.frame_record import FrameRecord, record_frame
from policies.evaluation.records import BinRecord
from policies.evaluation.summary import summarise
from policies.grasping.outcomes import GraspOutcome, PickResult
from policies.report.gallery import relative_folder
from policies.report.report import write_report
from tests.policies.fake_cell import abstain, attempt, bin_result, candidate, labelled_capture

CONFIG = EvaluationConfig(part="odd <&> name.stl")
MISSED, DELIVERED = GraspOutcome.MISSED, GraspOutcome.DELIVERED
_VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Collects ids, links and pictures; fails on a closing tag without its opening tag."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.pictures: list[str] = []
        self.figures: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        if tag not in _VOID:
            self.open.append(tag)
        self.ids += [values["id"]] if "id" in values else []
        self.links += [values["href"]] if "href" in values else []
        self.pictures += [values["src"]] if tag == "img" else []
        self.figures += [values["class"]] if tag == "figure" and "class" in values else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def compared() -> FrameRecord:
    view = labelled_capture(np.array([1.0, 1.0]))
    return record_frame(-1, view, ObservedCandidates(candidates=[candidate(view, 1)]))


@pytest.fixture
def report(tmp_path: Path) -> Callable[..., str]:
    def write(*picks: PickResult, pictures: bool = True, **facts: str) -> str:
        names = [f"bin 0 pick {k}.webp" if pictures else "" for k in range(len(picks))]
        common = {"config_hash": CONFIG.digest(), "index": 0, "wall": 9.0, "settle": 1.0, "render": 1.0}
        records = [BinRecord.from_result(bin_result(*picks, parts=100), names, [compared()], **common, **facts)]
        summary = summarise(records, CONFIG, np.random.default_rng(0))
        write_report(tmp_path / "report.html", summary, records, tmp_path / "pictures")
        return (tmp_path / "report.html").read_text()

    return write


def test_the_page_is_whole_and_needs_no_network_and_no_script(report: Callable[..., str]) -> None:
    text = report(attempt(DELIVERED), attempt(MISSED), abstain())
    assert Page(text).open == []
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)


def test_the_page_shows_numbers_attempts_and_failures(report: Callable[..., str]) -> None:
    text = report(attempt(DELIVERED), attempt(MISSED), abstain())
    for part in ("50.0 %", "1 of 2 attempts", "3 decisions", "30.0", "no candidate", "odd &lt;&amp;&gt; name.stl"):
        assert part in text
    for part in ("recognition", "failed at grasp", "part 1, score 0.90, off by 0.0 mm, 0.0°", "1 candidates"):
        assert part in text


def test_every_decision_has_a_picture_failures_first(report: Callable[..., str]) -> None:
    page = Page(report(*[attempt(DELIVERED)] * 70, abstain(), attempt(MISSED), attempt(GraspOutcome.LEFT_BIN)))
    kinds = ["is-missed", "is-left_bin", "is-no_candidate", *["is-delivered"] * 70]
    assert [classes.split()[0] for classes in page.figures] == kinds
    assert page.figures[1].split() == ["is-left_bin", "is-failed", "is-failed-at-physics"]
    names = [unquote(source) for source in page.pictures]
    assert names[:3] == [f"pictures/bin 0 pick {k}.webp" for k in (71, 72, 70)]
    assert len(set(names)) == 73


def test_every_link_has_its_target_and_every_aggregate_its_link(report: Callable[..., str]) -> None:
    text = report(attempt(DELIVERED), attempt(MISSED), abstain(), attempt(GraspOutcome.DOUBLE))
    page = Page(text)
    assert len(page.ids) == len(set(page.ids))
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)
    assert {f"#bin-0-pick-{k}" for k in range(4)} <= set(page.links)
    for kind in ("delivered", "missed", "double", "failed", "no_candidate", "failed-at-grasp", "failed-at-physics"):
        assert f"#only-{kind}" in page.links
        # All others are hidden, and one at least is not.
        assert f"#only-{kind}:target ~ .picks > figure:not(.is-{kind}) {{ display: none; }}" in text
        assert any(f"is-{kind}" in classes.split() for classes in page.figures)
    assert "#only-slipped" not in page.links  # there is nothing to show
    targets = text.index("id='only-missed'")
    assert targets < text.index("<div class='grid gallery picks'>")  # where the general sibling selector looks


def test_the_page_is_complete_without_pictures_and_without_attempts(report: Callable[..., str]) -> None:
    assert Page(report(attempt(MISSED), pictures=False)).pictures == []
    text = report(abstain(), abstain())
    assert Page(text).open == []
    assert "0 of 0 attempts" in text


def test_a_missing_view_of_the_bin_is_noted(report: Callable[..., str]) -> None:
    assert report(attempt(MISSED), before="a.jpg", after="b.jpg").count("no picture") == 2


def test_paths_of_pictures_are_relative_to_the_page(tmp_path: Path) -> None:
    assert relative_folder(tmp_path / "a" / "b", tmp_path / "a" / "r.html") == "b"
    assert relative_folder(tmp_path / "a", tmp_path / "a" / "r.html") == "."
    assert relative_folder(tmp_path / "a", tmp_path / "b" / "r.html") == "../a"


def test_the_interval_is_drawn_to_scale() -> None:
    assert "left:25.00%;width:50.00%" in tile("x", "50 %", "", (0.25, 0.75, 0.5))
