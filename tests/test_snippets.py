"""The Python snippets of README, site and BENCHMARK.md: they run, and what they find is right."""

import ast
import builtins
import importlib
import inspect
import re
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import trimesh
from gymnasium.envs.registration import load_env_creator

from tests.pages import PAGES, ROOT, blocks, fences, name_of
from tests.snippet_checks import CHECKS

BENCHMARK = ROOT / "BENCHMARK.md"
LANGUAGES = {"python", "sh", "text", "{math}", "{eval-rst}", "{include}", "{toctree}"}
SNIPPETS = [path for path in PAGES if blocks(path, "python")]
LONG = blocks(BENCHMARK, "python")  # most take minutes
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def test_every_code_block_has_a_language_that_a_test_knows() -> None:
    pages = [*PAGES, BENCHMARK, ROOT / "findings" / "README.md", ROOT / "examples" / "README.md"]
    found = {(name_of(path), language) for path in pages for language, _ in fences(path)}
    assert len(found) > 30
    assert {(page, language) for page, language in found if language not in LANGUAGES} == set()


def test_no_python_hides_in_a_block_of_text() -> None:
    for path in [*PAGES, BENCHMARK]:
        for text in blocks(path, "text"):
            assert not re.search(r"(?m)^(from \S+ )?import \w", text), (name_of(path), text)


def test_every_page_with_snippets_has_a_check() -> None:
    assert {name_of(path) for path in SNIPPETS} == set(CHECKS)


@pytest.mark.slow
@pytest.mark.parametrize("path", SNIPPETS, ids=name_of)
def test_a_pages_snippets_run_and_find_what_the_page_says(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    shown, last, before = "", "", ""
    for language, text in fences(path):
        if language == "python":  # one after the other: the second goes on with the names of the first
            exec(compile(text, path.name, "exec"), names)
            last = capsys.readouterr().out
            shown += last
        elif (language, before) == ("text", "python"):  # what the snippet prints, up to the digits
            assert NUMBER.sub("#", text) == NUMBER.sub("#", last)
        before = language
    CHECKS[name_of(path)](names, shown)
    for value in names.values():
        if isinstance(value, gym.Env):
            value.close()


def stored(tree: ast.AST) -> set[str]:
    """Return every name that a snippet defines, wherever in it."""
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load)}
    names |= {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    return names | {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}


def imported(tree: ast.AST) -> dict[str, Any]:
    """Import what a snippet imports; return it by the names that it gets there."""
    found: dict[str, Any] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                module = importlib.import_module(alias.name)
                found[alias.asname or alias.name.partition(".")[0]] = (
                    module if alias.asname else importlib.import_module(alias.name.partition(".")[0])
                )
        elif isinstance(node, ast.ImportFrom) and node.module:
            module = importlib.import_module(node.module)
            found |= {alias.asname or alias.name: getattr(module, alias.name) for alias in node.names}
    return found


def resolved(node: ast.expr, names: dict[str, Any]) -> Any:
    """Return the object that ``a`` or ``a.b.c`` stands for where ``a`` is imported; None for anything else."""
    if isinstance(node, ast.Name):
        return names.get(node.id)
    if isinstance(node, ast.Attribute) and (owner := resolved(node.value, names)) is not None:
        return getattr(owner, node.attr)
    return None


def calls(tree: ast.AST, names: dict[str, Any]) -> Iterator[tuple[Any, ast.Call]]:
    """Yield calls of this project's functions and classes, and of its environments, without ``*`` and ``**``."""
    for node in ast.walk(tree):
        called = resolved(node.func, names) if isinstance(node, ast.Call) else None
        if called is gym.make and isinstance(node, ast.Call) and isinstance(node.args[0], ast.Constant):
            called, node = load_env_creator(str(gym.spec(node.args[0].value).entry_point)), deepcopy(node)
            node.args = node.args[1:]  # the rest are the environment's
        home = str(getattr(called, "__module__", "")).partition(".")[0]
        if not isinstance(node, ast.Call) or home not in ("perception", "binpick_env", "policies"):
            continue
        if not any(isinstance(arg, ast.Starred) for arg in node.args) and all(k.arg for k in node.keywords):
            yield called, node


@pytest.mark.parametrize("number", range(len(LONG)))
def test_a_benchmarks_snippet_uses_what_exists(number: int) -> None:
    tree = ast.parse(LONG[number])
    names = imported(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            resolved(node, names)  # AttributeError if a module or class has no such name
    loaded = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)}
    assert loaded - set(names) - stored(tree) - set(dir(builtins)) == set()
    for called, node in calls(tree, names):
        given = {keyword.arg: None for keyword in node.keywords if keyword.arg}
        inspect.signature(called).bind(*node.args, **given)  # TypeError if an argument is unknown or missing


def test_the_benchmarks_plates_are_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (snippet,) = (text for text in LONG if "notched_plate.stl" in text and "binpick_env" not in text)
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, BENCHMARK.name, "exec"), {})
    for name, sides, volume in (
        ("plate.stl", (0.080, 0.050, 0.006), 0.080 * 0.050 * 0.006 - 0.048 * 0.024 * 0.003),
        ("notched_plate.stl", (0.070, 0.045, 0.005), None),
    ):
        mesh = trimesh.load_mesh(name)
        assert mesh.is_watertight
        assert mesh.extents == pytest.approx(sides, abs=1e-6)
        if volume is not None:
            assert mesh.volume == pytest.approx(volume, rel=1e-5)
