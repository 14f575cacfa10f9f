"""The public API: what the packages declare exists, is documented, and costs nothing until it is used."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = [
    str(path.parent.relative_to(ROOT)).replace("/", ".")
    for name in ("perception", "binpick_env", "policies")
    for path in sorted((ROOT / name).rglob("__init__.py"))
    if path.parent.name not in ("peers", "commands")  # programs, which nobody imports
]
SOURCES = sorted(path for name in ("perception", "binpick_env", "policies") for path in (ROOT / name).rglob("*.py"))
MOST_PARAMETERS = 6
ENVIRONMENTS = ("BinPickEnv.__init__", "GraspSelectionEnv.__init__")  # as many as gym.make takes
# What an argument must not begin with: it would say nothing without the argument's name.
ELLIPTIC = re.compile(r"(Of|That|Its|Theirs|Who|Whose|So many|To which|From which|Such)\b")


def functions(path: Path) -> list[tuple[str, ast.FunctionDef]]:
    """Return every function of a file with its qualified name."""
    found: list[tuple[str, ast.FunctionDef]] = []

    def walk(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef):
                found.append((prefix + child.name, child))
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                walk(child, f"{prefix}{child.name}.")

    walk(ast.parse(path.read_text(encoding="utf-8")), "")
    return found


def parameters(function: ast.FunctionDef) -> int:
    names = [each.arg for each in (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def compiled(function: ast.FunctionDef) -> bool:
    return any("njit" in ast.unparse(decorator) for decorator in function.decorator_list)


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_exists_and_is_documented(name: str) -> None:
    package = importlib.import_module(name)
    assert package.__doc__
    assert len(set(package.__all__)) == len(package.__all__) > 0
    for public in package.__all__:
        value = getattr(package, public)
        submodule = ROOT / name.replace(".", "/") / public
        if not inspect.ismodule(value):  # a name that is a submodule's, too, would be one or the other
            assert not submodule.is_dir()
            assert not submodule.with_suffix(".py").exists()
        if inspect.isclass(value) or inspect.isroutine(value) or inspect.ismodule(value):
            assert (inspect.getdoc(value) or "").strip(), f"{name}.{public} has no docstring"
    assert set(package.__all__) <= set(dir(package))


@pytest.mark.parametrize("name", PACKAGES)
def test_the_stub_of_a_package_lists_what_it_offers(name: str) -> None:
    stub = ROOT / name.replace(".", "/") / "__init__.pyi"
    imported = [
        alias.asname or alias.name
        for node in ast.parse(stub.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ImportFrom) and node.level == 1
        for alias in node.names
    ]
    assert sorted(importlib.import_module(name).__all__) == sorted(imported)


def test_importing_the_packages_imports_nothing_heavy() -> None:
    heavy = ("torch", "mujoco", "numba", "cv2", "trimesh", "scipy", "mink", "tyro", "stable_baselines3")
    code = f"import sys, {', '.join(name for name in PACKAGES)}; print([n for n in {heavy!r} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_function_has_more_parameters_than_a_reader_can_hold(path: Path) -> None:
    crowded = [
        f"{name} ({parameters(function)})"
        for name, function in functions(path)
        if parameters(function) > MOST_PARAMETERS and not compiled(function) and name not in ENVIRONMENTS
    ]
    assert crowded == []


def test_arguments_are_described_so_that_they_are_understood_without_their_names() -> None:
    unclear, count = [], 0
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef | ast.ClassDef):
                continue
            for section in re.findall(r"(?ms)^(?:Args|Attributes):\n(.*?)(?=^\w|\Z)", ast.get_docstring(node) or ""):
                for argument, text in re.findall(r"(?m)^    (\w+): (.*)$", section):
                    count += 1
                    if ELLIPTIC.match(text):
                        unclear.append(f"{path.relative_to(ROOT)} {node.name}: {argument}: {text}")
    assert count > 1000
    assert unclear == []


def test_programs_offer_nothing_to_import() -> None:
    for name in ("policies.commands", "policies.benchmarks.peers"):
        assert getattr(importlib.import_module(name), "__all__", []) == []


def test_no_property_begins_with_what_the_reference_would_show_as_a_type() -> None:
    """Napoleon takes the words before a colon in a property's first line for its type."""
    found, count = [], 0
    for path in SOURCES:
        for name, function in functions(path):
            if any(re.search(r"property$", ast.unparse(decorator)) for decorator in function.decorator_list):
                count += 1
                line = (ast.get_docstring(function) or "").partition("\n")[0]
                if ":" in re.sub(r":\w+:`", "`", line):  # a reference such as :func:`name` is none
                    found.append(f"{path.relative_to(ROOT)} {name}: {line}")
    assert count > 100
    assert found == []
