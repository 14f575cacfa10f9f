"""The pages that a user reads: README, the guide for contributors and the site, and the code blocks in them."""

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


def fences(path: Path) -> list[tuple[str, str]]:
    """Return language and text of a page's code blocks in order."""
    found: list[tuple[str, list[str]]] = []
    inside = False
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.lstrip().startswith("```"):
            inside = not inside
            if inside:
                found.append((line.strip().strip("`").split(" ")[0], []))
        elif inside:
            found[-1][1].append(line)
    assert not inside, f"{name_of(path)} ends within a code block"
    return [(language, "".join(f"{line}\n" for line in lines)) for language, lines in found]


def blocks(path: Path, language: str) -> list[str]:
    return [text for found, text in fences(path) if found == language]


def shell_lines(block: str) -> list[list[str]]:
    """Return the words of each line of a shell block; comments and empty lines are left out."""
    lines = block.replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def command_lines(path: Path) -> list[list[str]]:
    """Return the words after ``binpick`` of every line of a page's shell blocks that calls it."""
    return [words[1:] for block in blocks(path, "sh") for words in shell_lines(block) if calls_binpick(words)]


def calls_binpick(words: list[str]) -> bool:
    return Path(words[0]).name == "binpick"
