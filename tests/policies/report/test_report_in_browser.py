"""The page in headless Chromium: filters, enlarging, both widths, and neither errors nor requests."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from policies.evaluation.config import EvaluationConfig
from policies.evaluation.records import BinRecord
from policies.evaluation.summary import summarise
from policies.grasping.outcomes import GraspOutcome
from policies.report.pick_picture import CROP_PX
from policies.report.report import write_report
from tests.policies.evaluation.test_undelivered import LEFT, LOST
from tests.policies.fake_cell import abstain, attempt, bin_result
from tests.policies.report.test_report import compared

pytestmark = pytest.mark.slow
PICKS = [attempt(GraspOutcome.MISSED), attempt(GraspOutcome.DELIVERED), attempt(GraspOutcome.DELIVERED), abstain()]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a page of one bin with four decisions and a long part name."""
    folder = tmp_path_factory.mktemp("page")
    config = EvaluationConfig(part="a_part_with_a_name_that_is_longer_than_the_screen_of_a_telephone.stl")
    names = [f"{k}.webp" for k in range(len(PICKS))]
    for name, size in [(name, (CROP_PX, CROP_PX)) for name in names] + [("b.jpg", (480, 640)), ("a.jpg", (480, 640))]:
        cv2.imwrite(str(folder / name), np.full((*size, 3), 128, np.uint8))
    facts: Any = {"config_hash": config.digest(), "index": 0, "wall": 9.0, "settle": 1.0, "render": 1.0}
    facts |= {"before": "b.jpg", "after": "a.jpg", "undelivered": (LEFT, LOST)}
    records = [BinRecord.from_result(bin_result(*PICKS), names, [compared()], **facts)]
    path = folder / "report.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(EvaluationConfig, "weights", lambda _: None)  # which reads the part's file
        summary = summarise(records, config, np.random.default_rng(0))
    assert write_report(path, summary, records, folder) == []
    for file in folder.iterdir():
        if file != path:
            file.unlink()  # the page must do without them
    return path


@pytest.fixture(scope="module")
def page(browser: Any, written: Path) -> Any:
    """Return the opened page, whose ``faults`` collects console messages, errors and requests beyond the page."""
    opened = browser.new_page(viewport={"width": 1400, "height": 900})
    opened.faults = []
    opened.on("console", lambda message: opened.faults.append(message.text))
    opened.on("pageerror", lambda error: opened.faults.append(str(error)))
    address = written.as_uri()
    opened.on(
        "request",
        lambda request: request.url.startswith(("data:", address)) or opened.faults.append(request.url),
    )
    opened.goto(address)
    return opened


def shown(page: Any) -> int:
    """Return the number of decisions that are shown."""
    return int(page.evaluate("[...document.querySelectorAll('.picks > figure')].filter(e => e.offsetParent).length"))


def test_all_pictures_are_inside_and_described(page: Any) -> None:
    pictures = page.evaluate("[...document.images].map(e => [e.src.slice(0, 11), e.naturalWidth, e.alt.length > 9])")
    assert pictures == [["data:image/", CROP_PX, True]] * 4 + [["data:image/", 640, True]] * 2


@pytest.mark.parametrize("width", [400, 1400])
def test_the_page_is_as_wide_as_the_window(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    page.evaluate("document.querySelectorAll('details').forEach(e => e.open = true)")
    assert page.evaluate("document.documentElement.scrollWidth") == width


def test_a_filter_shows_one_kind_alone_and_all_again(page: Any) -> None:
    assert shown(page) == 4
    for kind, number in (("delivered", 2), ("missed", 1), ("no_candidate", 1), ("all", 4)):
        page.click(f".filters a[href='#only-{kind}']")
        assert shown(page) == number


def drawn(picture: Any) -> tuple[float, float]:
    """Return width and height of a picture as it is drawn, without the bands that its box may have [px]."""
    size = "e => [e.clientWidth, e.clientHeight, e.naturalWidth, e.naturalHeight, getComputedStyle(e).objectFit]"
    width, height, whole_width, whole_height, fit = picture.evaluate(size)
    if fit != "contain":
        return width, height
    scale = min(width / whole_width, height / whole_height)
    return scale * whole_width, scale * whole_height


@pytest.mark.parametrize(("width", "least"), [(400, 900), (1400, 860)])
def test_a_click_enlarges_a_picture_and_the_next_one_puts_it_back(page: Any, width: int, least: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    page.click(".filters a[href='#only-delivered']")
    small = page.locator(".picks img").nth(3)
    before = drawn(small)
    small.click()
    large = drawn(small)
    assert min(large) >= least > 2 * before[0]
    assert large[0] / large[1] == pytest.approx(1.0)  # as in the file
    box = page.evaluate("(e => [e.clientWidth, e.scrollWidth])(document.querySelector('.zoom:popover-open'))")
    assert box == [width, max(width, least)]  # what is wider than the window is scrolled to
    assert page.evaluate("document.documentElement.scrollWidth") == width
    small.click()
    assert drawn(small) == before
    assert shown(page) == 2  # the filter stays
    page.click(".filters a[href='#only-all']")


def test_escape_puts_an_enlarged_picture_back(page: Any) -> None:
    page.set_viewport_size({"width": 1400, "height": 900})
    small = page.locator(".picks img").nth(0)
    before = drawn(small)
    for key in ("Enter", "Escape"):  # the keyboard opens it, too
        small.locator("..").focus()
        page.keyboard.press(key)
        assert (drawn(small) == before) == (key == "Escape")
    assert page.evaluate("document.querySelectorAll('script').length") == 0


def test_there_were_neither_errors_nor_requests(page: Any) -> None:
    page.wait_for_load_state("networkidle")
    assert page.faults == []
