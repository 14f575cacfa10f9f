"""The pages that a user reads: README, the guide for contributors and the site, and the code blocks in them."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(p for p in (ROOT / "docs").rglob("*.md") if p.parent.name != "_generated"),
]


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", path.read_text(encoding="utf-8"), flags=re.DOTALL)


def shell_lines(block: str) -> list[list[str]]:
    """Return the words of each line of a shell block; comments and empty lines are left out."""
    lines = block.replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def command_lines(path: Path) -> list[list[str]]:
    """Return the words after ``binpick`` of every line of a page's shell blocks that calls it."""
    return [words[1:] for block in blocks(path, "sh") for words in shell_lines(block) if calls_binpick(words)]


def calls_binpick(words: list[str]) -> bool:
    return Path(words[0]).name == "binpick"
