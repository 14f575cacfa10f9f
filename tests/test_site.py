"""README and site: snippets run, links lead somewhere, the built pages load nothing from a network."""

import importlib
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from policies.commands.command_line import parse
from policies.commands.registry import COMMANDS
from tests.pages import PAGES, ROOT, command_lines, name_of


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
    targets = re.findall(r"\]\((?!https?:|#)([^)#\s]+)", path.read_text())
    assert [target for target in targets if not (path.parent / target).exists()] == []


def test_every_command_is_in_the_reference() -> None:
    text = (ROOT / "docs" / "reference" / "commands.md").read_text()
    assert set(re.findall(r"^\| `binpick ([\w-]+)` \|", text, flags=re.MULTILINE)) == {each.name for each in COMMANDS}


def test_the_readme_fits_on_a_page() -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    assert len(lines) <= 160
    assert [line for line in lines if len(line) > 100] == []


def test_every_page_is_in_the_table_of_contents() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    pages = {
        str(path.relative_to(ROOT / "docs").with_suffix("")) for path in PAGES if path.is_relative_to(ROOT / "docs")
    }
    assert {page for page in pages if page != "index" and page not in index.splitlines()} == set()


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_loads_nothing_from_a_network(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "docs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = sorted(tmp_path.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        references = References()
        references.feed(page.read_text())
        assert references.found, page
        for reference in references.found:
            assert not re.match(r"(https?:)?//", reference), (page, reference)
            if not reference.startswith("data:"):
                assert (page.parent / reference.split("?")[0]).exists(), (page, reference)
    styles = "".join(path.read_text(errors="replace") for path in tmp_path.rglob("*.css"))
    assert re.findall(r"(?:url\(|@import )['\"]?https?:[^)'\"]+", styles) == []
    assert "GSR" in (tmp_path / "explanation" / "numbers.html").read_text()
    assert "PoseEstimator" in (tmp_path / "reference" / "perception.html").read_text()
