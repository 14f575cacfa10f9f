import ast
import importlib
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("perception", "binpick_env", "policies")
SOURCES = sorted(path for name in (*PACKAGES, "scripts") for path in (ROOT / name).rglob("*.py"))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_imports_point_one_way() -> None:
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()", "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_importing_the_environment_or_a_trainings_error_leaves_heavy_packages_alone() -> None:
    code = "import sys, binpick_env.env, perception.segmentation.training.errors; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"binpick_env.env", "perception.segmentation.training.errors"} <= loaded
    assert not loaded & {"torch", "stable_baselines3", "matplotlib", "tyro"}


def matching(pattern: str, paths: Iterable[Path]) -> list[str]:
    """Return the names of the files in which a line matches a pattern."""
    return [name_of(path) for path in paths if re.search(pattern, path.read_text(encoding="utf-8"), flags=re.MULTILINE)]


def test_texts_are_read_and_written_in_utf_8_whatever_the_locale() -> None:
    assert matching(r"\.read_text\((?!encoding)|\.write_text\((?!.*encoding)", SOURCES) == []


def test_files_of_users_are_written_atomically() -> None:
    """Elsewhere a full disk leaves half a file, and an error that does not name it."""
    temporary = ("policies/soak/", "policies/benchmarks/clusters/", "binpick_env/jobs/node.py")
    temporary += ("binpick_env/parts/mesh_formats.py",)  # gives a library a file of its own
    paths = [path for path in SOURCES if not name_of(path).startswith(temporary)]
    assert matching(r"^(?!.*\bdraft\b).*(\.write_(text|bytes)\(|\bimwrite\()", paths) == []


def longer_than(most: int, paths: Iterable[Path]) -> list[str]:
    """Return the files of more lines, which hold two ideas."""
    lengths = {name_of(path): path.read_text(encoding="utf-8").count("\n") for path in paths}
    return [f"{name}: {lines} lines" for name, lines in lengths.items() if lines > most]


def test_files_are_small_and_well_named() -> None:
    assert len(SOURCES) > 100
    assert longer_than(399, SOURCES) == []
    assert longer_than(139, [path for path in SOURCES if path.parent.name == "scripts"]) == []
    assert [name_of(path) for path in SOURCES if path.stem in ("utils", "helpers", "misc")] == []


def test_libraries_parse_no_command_line() -> None:
    libraries = [path for path in SOURCES if path.parent.name not in ("scripts", "commands")]
    assert matching(r"^\s*(import|from) (tyro|argparse)\b", libraries) == []
    assert matching("__main__", libraries) == []


def test_every_package_is_typed() -> None:
    assert all((ROOT / name / "py.typed").is_file() for name in PACKAGES)


def test_the_readmes_files_exist() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    targets = re.findall(r"\]\((?!https?:)([^)#]+)\)", text) + re.findall(r"scripts/\w+\.py", text)
    assert targets
    assert [target for target in targets if not (ROOT / target).exists()] == []


def test_the_makefiles_help_names_every_target() -> None:
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    (phony,) = re.findall(r"^\.PHONY: (.*)$", text, flags=re.MULTILINE)
    documented = set(re.findall(r"^([a-z-]+):.*## ", text, flags=re.MULTILINE))
    assert set(phony.split()) == documented


def test_constraints_pin_every_dependency_exactly() -> None:
    lines = [
        line
        for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
        if line and not line.startswith("#")
    ]
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines)  # no local versions such as +cpu
    pinned = {re.sub(r"[-_.]+", "-", line.split("==")[0]).lower() for line in lines}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [
        *project["dependencies"],
        *(name for extra in project["optional-dependencies"].values() for name in extra),
    ]
    assert {re.split(r"[><=!]", name)[0].lower().replace("_", "-") for name in wanted} <= pinned


def test_every_upper_bound_has_its_reason_beside_it() -> None:
    lines = (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines()
    bounded = [line for line in lines if re.search(r'"[\w.-]+[^";]*(<|!=|~=|==)', line.split("#")[0])]
    assert [line for line in bounded if not re.search(r"#\s+\w+", line)] == []


@pytest.mark.parametrize("name", ["README.md", "BENCHMARK.md", "CHANGELOG.md"])
def test_no_figure_is_left_open(name: str) -> None:
    assert "TODO" not in (ROOT / name).read_text(encoding="utf-8")


def test_one_registration_is_all_that_points_against_the_imports() -> None:
    """The linter sees no strings: an entry point that names a package further up would escape it."""
    upward = {"perception": ("binpick_env", "policies"), "binpick_env": ("policies",)}
    found = []
    for package, above in upward.items():
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    named = re.fullmatch(r"(\w+)(\.\w+)+(:\w+)?", node.value)
                    if named and named.group(1) in above:
                        found.append((name_of(path), node.value))
    assert found == [("binpick_env/__init__.py", "policies.selection.env:GraspSelectionEnv")]
    module, _, attribute = found[0][1].partition(":")
    assert hasattr(importlib.import_module(module), attribute)


def test_test_files_are_small() -> None:
    tests = sorted((ROOT / "tests").rglob("*.py"))
    assert len(tests) > 100
    assert longer_than(400, tests) == []


def test_nothing_imports_a_command() -> None:
    others = [path for path in SOURCES if not {"scripts", "commands"} & set(path.parts)]
    assert len(others) > 100
    assert matching(r"^\s*(import|from) policies\.commands\b", others) == []
