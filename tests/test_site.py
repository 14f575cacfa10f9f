"""README and site: snippets run, links lead somewhere, the built pages load nothing from a network."""

import importlib
import pkgutil
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perception.pose.hypotheses.voting import VoteConfig
from perception.pose.verification.confidence import ConfidenceConfig
from perception.pose.verification.expected_error import CORRELATED, UNKNOWN
from perception.pose.verification.joint_refinement import JointRefinement
from perception.pose.verification.perturbation import ANGLE
from perception.pose.verification.verification import VerificationConfig
from perception.segmentation.grouping.similarity import GroupingConfig
from policies.commands.command_line import parse
from policies.commands.registry import COMMANDS
from tests.pages import PAGES, ROOT, command_lines, name_of

# of the window, and of what the contents would have to be scrolled by
WIDTHS = """[document.documentElement.scrollWidth,
    Math.max(...[...document.querySelectorAll('.content')].map(e => e.scrollWidth - e.clientWidth))]"""


class References(HTMLParser):
    """Collects what a page would load: scripts, styles, images, frames."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        if tag in ("script", "img", "iframe", "source", "video") and named.get("src"):
            self.found.append(str(named["src"]))
        if tag == "link" and named.get("href") and named.get("rel") in ("stylesheet", "icon", "preload"):
            self.found.append(str(named["href"]))


class OptionsReadError(Exception):
    """Ends a command once its options are read."""


@pytest.mark.parametrize("path", [page for page in [*PAGES, ROOT / "BENCHMARK.md"] if command_lines(page)], ids=name_of)
def test_every_command_line_is_one_that_the_command_takes(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {command.name: command.module for command in COMMANDS}
    for line in command_lines(path):
        module = importlib.import_module(names[line[0]])

        def read(options: object, command: str, arguments: list[str], line: list[str] = line) -> None:
            assert command == line[0]
            raise OptionsReadError(repr(parse(options, command, arguments)))

        monkeypatch.setattr(module, "parse", read)
        with pytest.raises(OptionsReadError):  # SystemExit if an option is unknown
            module.main(line[1:])


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_links_lead_somewhere(path: Path) -> None:
    targets = re.findall(r"\]\((?!https?:|#)([^)#\s]+)", path.read_text(encoding="utf-8"))
    assert [target for target in targets if not (path.parent / target).exists()] == []


def test_every_command_is_in_the_reference() -> None:
    text = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `binpick ([\w-]+)` \|", text, flags=re.MULTILINE)) == {each.name for each in COMMANDS}


def test_the_readme_fits_on_a_page() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 160
    assert [line for line in lines if len(line) > 100] == []


def test_the_methods_equations_name_functions_that_exist() -> None:
    text = (ROOT / "docs" / "explanation" / "method.md").read_text(encoding="utf-8")
    names = set(re.findall(r"`((?:perception|binpick_env|policies)(?:\.\w+)+)`", text))
    assert len(names) > 20
    assert [name for name in sorted(names) if fault_of_name(name)] == []
    for line in re.findall(r"(?m)^Functions?: (.*(?:\n(?!\n).*)*)", text):  # as well as `a` and `b` in `module`
        for found in re.finditer(r"((?:`\w+`(?:, | and )?)+)(?: \w+)? in `([\w.]+)`", line):
            module = importlib.import_module(found[2])
            for name in re.findall(r"`(\w+)`", found[1]):
                assert hasattr(module, name), f"{found[2]}.{name}"


def fault_of_name(name: str) -> str | None:
    """Return why a dotted name leads to nothing; None if it leads somewhere."""
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError) as error:
        return str(error)
    return None


def test_the_methods_equations_have_the_codes_numbers() -> None:
    text = (ROOT / "docs" / "explanation" / "method.md").read_text(encoding="utf-8")
    ranked, score, joint, votes = VerificationConfig(), ConfidenceConfig(), JointRefinement(), VoteConfig()
    for wanted in (
        rf"= {ranked.bias} + {ranked.edge_weight}\, s_e + {ranked.explained_weight}\, s_x",
        rf"+ {ranked.support_weight}\, s_s - {-ranked.violation_weight}\, s_v",
        f"clipped at {score.clear:g} and at {score.close:g}",
        rf"\sigma_0 = {np.degrees(score.exact):g}$ and $\sigma_1 = {np.degrees(score.unknown):g}$ degrees",
        rf"= {score.patch_weight} \max(0, k - {score.patch:g}) - {-score.stray_weight:g} \max(0, o - {score.stray})",
        rf"- {-score.noise_weight:g} \max(0, \sigma - {score.noise:g})",
        rf"\frac{{H}}{{({CORRELATED}\, \sigma_d)^2}}",
        f"is {joint.edge_noise} pixels at the part's depth",
        rf"\bar\rho = \frac{{1}}{{{(2 * joint.patch + 1) ** 2}}}",
        f"$B = {votes.bins}$ bins",
        f"at least {votes.second_peak} of the votes",
        rf"$d = {1 + GroupingConfig().slack:g}\, d_{{max}}$",
    ):
        assert wanted in text, wanted
    assert (joint.averaged, UNKNOWN, np.degrees(ANGLE)) == (0.5, 1.0, pytest.approx(8.0))  # given in words


def test_every_page_is_in_the_table_of_contents() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    pages = {
        str(path.relative_to(ROOT / "docs").with_suffix("")) for path in PAGES if path.is_relative_to(ROOT / "docs")
    }
    assert {page for page in pages if page != "index" and page not in index.splitlines()} == set()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site as `make docs` does, once for all tests."""
    built = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "docs", str(built)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return built


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_loads_nothing_from_a_network(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        references = References()
        references.feed(page.read_text(encoding="utf-8"))
        assert references.found, page
        for reference in references.found:
            assert not re.match(r"(https?:)?//", reference), (page, reference)
            if not reference.startswith("data:"):
                assert (page.parent / reference.split("?")[0]).exists(), (page, reference)
    styles = "".join(path.read_text(encoding="utf-8", errors="replace") for path in site.rglob("*.css"))
    assert re.findall(r"(?:url\(|@import )['\"]?https?:[^)'\"]+", styles) == []


@pytest.mark.slow
def test_the_reference_shows_fields_and_short_types(site: Path) -> None:
    assert "GSR" in (site / "explanation" / "numbers.html").read_text(encoding="utf-8")
    text = re.sub(r"<[^>]+>", "", (site / "reference" / "perception.html").read_text(encoding="utf-8"))
    assert "PoseEstimator" in text
    assert "low – Canny’s weak threshold [grey levels]" in text  # the comment of a field
    assert "points_cam (NDArray[float64]) – (N, 3) float64 points in the camera frame [m]." in text
    assert "dtype[" not in text
    assert "Picker(*args" not in re.sub(
        r"<[^>]+>", "", (site / "reference" / "policies.html").read_text(encoding="utf-8")
    )


@pytest.mark.slow
def test_every_page_is_as_wide_as_the_window_and_at_peace_in_a_browser(site: Path, browser: Any) -> None:
    page = browser.new_page()
    faults: list[str] = []
    page.on("console", lambda message: faults.append(f"{page.url}: {message.text}"))
    page.on("pageerror", lambda error: faults.append(f"{page.url}: {error}"))
    page.on("request", lambda request: request.url.startswith(("file:", "data:")) or faults.append(request.url))
    for path in sorted(site.rglob("*.html")):
        page.goto(path.as_uri())
        for width in (400, 1400):
            page.set_viewport_size({"width": width, "height": 900})
            assert page.evaluate(WIDTHS) == [width, 0], (path, width)
        assert page.evaluate("[...document.images].filter(e => !e.complete || !e.naturalWidth).length") == 0, path
    assert faults == []


@pytest.mark.slow
def test_an_equations_number_does_not_lie_on_the_equation(site: Path, browser: Any) -> None:
    page = browser.new_page(viewport={"width": 400, "height": 900})
    page.goto((site / "explanation" / "method.html").as_uri())
    page.wait_for_selector("div.math mjx-container")
    for width in (400, 1400):
        page.set_viewport_size({"width": width, "height": 900})
        boxes = page.evaluate(
            """[...document.querySelectorAll('div.math:has(.eqno)')].map(e =>
            [e.querySelector('.eqno'), e.querySelector('mjx-math')].map(e => e.getBoundingClientRect().toJSON()))"""
        )
        assert len(boxes) == 2
        for number, equation in boxes:
            assert number["bottom"] <= equation["top"] + 1 or number["left"] >= equation["right"], width


@pytest.mark.slow
def test_tables_are_not_squeezed(site: Path, browser: Any) -> None:
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.goto((site / "explanation" / "faults.html").as_uri())
    wrappers = page.evaluate("[...document.querySelectorAll('.table-wrapper')].map(e => e.scrollWidth - e.clientWidth)")
    assert wrappers == [0] * len(wrappers) != []
    narrowest = "Math.min(...[...document.querySelectorAll('td')].map(e => e.offsetWidth))"
    for width in (400, 1400):
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate(narrowest) >= 110, width
    page.goto((site / "explanation" / "benchmark.html").as_uri())
    figures = "[...document.querySelectorAll('td .figure')].map(e => e.getClientRects().length)"
    assert len(page.evaluate(figures)) > 100
    for width in (400, 1400):
        page.set_viewport_size({"width": width, "height": 900})
        assert set(page.evaluate(figures)) == {1}, width
