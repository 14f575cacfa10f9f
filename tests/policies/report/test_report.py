import base64
import csv
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binpick_env.jobs.report_style import tile
from binpick_env.jobs.text_tables import fine
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.oracle import PoseNoise
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.frame_record import FrameRecord, SegmentTable, record_frame
from policies.evaluation.records import BinRecord
from policies.evaluation.summary import summarise
from policies.grasping.outcomes import GraspOutcome, PickResult
from policies.report.picture_source import PictureSource
from policies.report.report import write_report
from tests.policies.evaluation.test_undelivered import LEFT, LOST
from tests.policies.fake_cell import abstain, attempt, bin_result, candidate, labelled_capture, pushed

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
        self.alts: list[str] = []
        self.figures: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        if tag not in _VOID:
            self.open.append(tag)
        self.ids += [values["id"]] if "id" in values else []
        self.links += [values["href"]] if "href" in values else []
        self.pictures += [values["src"]] if tag == "img" else []
        self.alts += [values["alt"]] if tag == "img" else []
        self.figures += [values["class"]] if tag == "figure" and "class" in values else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def compared() -> FrameRecord:
    view = labelled_capture(np.array([1.0, 1.0]))
    return record_frame(-1, view, ObservedCandidates(candidates=[candidate(view, 1)]))


@pytest.fixture
def report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    monkeypatch.setattr(EvaluationConfig, "weights", lambda _: None)  # which reads the part's file

    def write(
        *picks: PickResult, pictures: bool = True, config: EvaluationConfig = CONFIG, frames: Any = (), **facts: Any
    ) -> str:
        names = [f"bin 0 pick {k}.webp" if pictures else "" for k in range(len(picks))]
        (tmp_path / "pictures").mkdir(exist_ok=True)
        for name in filter(None, names):
            (tmp_path / "pictures" / name).write_text(name)
        common: Any = {"config_hash": config.digest(), "index": 0, "wall": 9.0, "settle": 1.0, "render": 1.0}
        seen = [*(frames or [compared()])]
        records = [BinRecord.from_result(bin_result(*picks, parts=100), names, seen, **common, **facts)]
        summary = summarise(records, config, np.random.default_rng(0))
        write_report(tmp_path / "report.html", summary, records, tmp_path / "pictures")
        return (tmp_path / "report.html").read_text(encoding="utf-8")

    return write


def test_the_page_is_whole_and_needs_no_network_and_no_script(report: Callable[..., str]) -> None:
    text = report(attempt(DELIVERED), attempt(MISSED), abstain())
    assert Page(text).open == []
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)


def test_the_page_shows_numbers_attempts_and_failures(report: Callable[..., str]) -> None:
    text = report(attempt(DELIVERED), attempt(MISSED), abstain())
    for part in ("50.0 %", "1 of 2 attempts", "3 decisions", "30.0", "no candidate", "odd &lt;&amp;&gt; name.stl"):
        assert part in text
    for part in ("pose accuracy", "failed at grasp", "part 1, score 0.90, off by 0 mm, ", "1 candidate"):
        assert part in text


def test_every_decision_has_a_picture_failures_first(report: Callable[..., str]) -> None:
    page = Page(report(*[attempt(DELIVERED)] * 70, abstain(), attempt(MISSED), attempt(GraspOutcome.LEFT_BIN)))
    kinds = ["is-missed", "is-left_bin", "is-no_candidate", *["is-delivered"] * 70]
    assert [classes.split()[0] for classes in page.figures] == kinds
    assert page.figures[1].split() == ["is-left_bin", "is-failed", "is-failed-at-physics"]
    names = [inside(source) for source in page.pictures]
    assert names[:3] == [f"bin 0 pick {k}.webp" for k in (71, 72, 70)]
    assert len(set(names)) == 73


def test_every_link_has_its_target_and_every_aggregate_its_link(report: Callable[..., str]) -> None:
    text = report(attempt(DELIVERED), attempt(MISSED), abstain(), attempt(GraspOutcome.DOUBLE))
    page = Page(text)
    assert len(page.ids) == len(set(page.ids))
    data = [link for link in page.links if link.startswith("data:text/csv")]
    assert len(data) == 1
    assert {link.removeprefix("#") for link in page.links if link not in data} <= set(page.ids)
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


def inside(source: str) -> str:
    """Return the contents of a data URI as text."""
    head, data = source.split(",")
    assert head.endswith(";base64")
    return base64.b64decode(data).decode()


def test_pictures_are_inside_up_to_a_limit_and_links_beyond(tmp_path: Path) -> None:
    (tmp_path / "a b").mkdir()
    for name, size in (("1.webp", 60), ("2.jpg", 60), ("3.webp", 40)):
        (tmp_path / "a b" / name).write_bytes(bytes(size))
    source = PictureSource(tmp_path / "a b", tmp_path / "x" / "r.html", limit=100)
    first = source.source("1.webp")
    assert first is not None
    assert first.startswith("data:image/webp;base64,AAAA")
    assert source.source("2.jpg") == "../a%20b/2.jpg"
    assert source.source("3.webp") == "data:image/webp;base64," + base64.b64encode(bytes(40)).decode()
    assert source.linked == ["2.jpg"]
    assert source.source("4.webp") is None
    assert source.source("") is None


def test_a_page_whose_pictures_are_beside_it_says_so(
    report: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PictureSource.__init__, "__defaults__", (30,))
    text = report(attempt(MISSED), attempt(DELIVERED))
    assert "1 pictures of deliveries are files beside this page" in text
    assert Page(text).pictures[1] == "pictures/bin%200%20pick%201.webp"


def test_every_picture_says_in_words_what_it_shows(report: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "b.jpg").write_text("b")
    page = Page(report(attempt(MISSED), abstain(), before="b.jpg", after="b.jpg"))
    assert "bin 0, decision 0: the grasp from above" in page.alts[0]
    assert page.alts[0].endswith("; missed")
    assert page.alts[1] == "bin 0, decision 1: the whole bin from above with all candidates; no attempt, no candidate"
    assert page.alts[2] == "bin 0 settled: 100 parts, seen from the tray's side"
    assert all(page.alts)


@pytest.mark.parametrize(
    ("perception", "given"), [("learned", set()), ("gt_masks", {"AP"}), ("oracle", {"AP", "pose accuracy", "recall"})]
)
def test_what_the_ground_truth_gave_is_labelled(report: Callable[..., str], perception: Any, given: set[str]) -> None:
    text = report(attempt(MISSED), config=replace(CONFIG, perception=perception))
    tiles = dict(re.findall(r"<div class='card tile'><span>([^<·]*?)(?: ·[^<]*)?</span><b>([^<]*)</b>", text))
    assert {name for name, value in tiles.items() if value == "given"} - {"precision", "pose errors"} == given
    assert tiles["DR"] == "0.0 %"
    assert ("not measured: true poses · " in text) == (perception == "oracle")


def test_noise_of_given_poses_is_said(report: Callable[..., str]) -> None:
    noisy = replace(CONFIG, perception="oracle", pose_noise=PoseNoise(translation=0.001))
    assert "not measured: true poses with noise" in report(attempt(MISSED), config=noisy)


def test_likely_causes_of_lost_parts_are_on_the_page(report: Callable[..., str]) -> None:
    text = report(attempt(MISSED), frames=[replace(compared(), causes=("floor_height",))])
    assert "likely causes of lost parts: floor height in 1 of 1 frames" in text


def test_settings_are_written_as_ranges_or_sizes_with_few_digits(report: Callable[..., str]) -> None:
    text = report(attempt(MISSED), config=replace(CONFIG, num_parts=(20, 25)))
    shown = dict(re.findall(r"<td>([a-z_.]+)</td><td><code>([^<]*)</code>", text))
    assert (shown["num_parts"], shown["bin"]) == ("20 to 25", "0.36 x 0.26 x 0.12")
    assert max(len(value) for name, value in shown.items() if "tilt" in name) <= 8


def test_every_average_precision_is_in_per_cent(report: Callable[..., str]) -> None:
    table = SegmentTable(scores=(0.9,), points=((0, 0, 100),))
    text = report(attempt(MISSED), frames=[replace(compared(), segments=table, explained=table)])
    assert "AP50 100.0 %, AP75 100.0 %" in text


def test_lost_and_left_parts_are_on_the_map_with_their_reasons(report: Callable[..., str]) -> None:
    text = report(attempt(MISSED), undelivered=(LEFT, LOST))
    assert "cx='280.0' cy='130.0'" in text  # 0.1 m along the bin of 0.36 m, in the middle across
    assert "<title>bin 0: part 1 left (not tried, the bin had ended, 50.0 % visible)</title>" in text
    assert "<title>bin 0: part 2 lost in decision 3 (double)</title>" in text
    assert "aria-label='Map of the bin from above: 1 parts left, 1 lost'" in text
    assert "Not recorded by the version that picked bins 0" in report(attempt(MISSED))
    assert "None: every part was delivered." in report(attempt(MISSED), undelivered=())


def test_pushes_are_counted_and_shown_among_the_decisions(report: Callable[..., str]) -> None:
    text = report(attempt(DELIVERED), pushed())
    assert "Pushes by outcome" in text
    assert "href='#only-moved'" in text
    assert "<figure id='bin-0-pick-1' class='is-moved'>" in text
    Page(text)
    assert "Pushes by outcome" not in report(attempt(DELIVERED))


def test_the_csv_in_the_page_has_a_line_for_each_decision(report: Callable[..., str]) -> None:
    links = Page(report(attempt(DELIVERED), abstain())).links
    text = inside(next(link for link in links if link.startswith("data:text/csv")))
    first, second = csv.DictReader(text.splitlines())
    assert (first["outcome"], first["width_mm"], first["feature_quality"]) == ("delivered", "30.0", "0.5")
    assert (first["pose_correct"], first["picture"]) == ("1", "bin 0 pick 0.webp")
    assert (second["outcome"], second["abstention"], second["score"]) == ("", "no_candidate", "")


def test_the_settings_of_the_cell_are_on_the_page(report: Callable[..., str]) -> None:
    text = report(attempt(MISSED))
    for name, value in (("bin", "0.36 x 0.26 x 0.12"), ("jaw", "0.085"), ("friction", "0.5"), ("sensor", "good")):
        assert f"<td>{name}</td><td><code>{value}</code></td>" in text
    assert "<td>camera.distance</td><td><code>0.9</code></td>" in text


@pytest.mark.parametrize(
    ("value", "text"), [(None, "–"), (0.0, "0"), (0.004, "< 0.01"), (0.04, "0.04"), (0.4, "0.40"), (4.0, "4.0")]
)
def test_a_small_error_is_not_written_as_nought(value: float | None, text: str) -> None:
    assert fine(value) == text


def test_the_interval_is_drawn_to_scale() -> None:
    assert "left:25.00%;width:50.00%" in tile("x", "50 %", "", (0.25, 0.75, 0.5))
