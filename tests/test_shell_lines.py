"""Every shell line of README and site runs on tiny settings, page by page, and does what the page says."""

import importlib
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.jobs.ray_cluster import leave_cluster
from perception.capture import write_frame
from perception.frame import Frame
from perception.geometry import make_transform
from perception.segmentation import weights
from policies.commands.command_line import parse
from policies.commands.registry import COMMANDS
from policies.soak import EnvSoak
from tests.pages import PAGES, ROOT, blocks, calls_binpick, command_lines, name_of, shell_lines
from tests.policies.commands.command_calls import run
from tests.shared_models import share_models, share_shaded_meshes
from tests.shell_line_checks import PARTS, TINY, Line

BLOCK = (50, 30, 20)  # sides of the part of one's own [mm]
EMPTY_BINS = ("bin_01", "bin_02")  # frames that the pages perceive
Story = list[list[str]]  # calls of binpick, without that word
DEPEND_ON_RESULTS = (
    "over bins", "attempts by outcome", "failed attempts by stage", "abstentions by reason", "bins by their end",
)  # fmt: skip
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
ALTERNATIVES = {"docs/howto/rooms.md"}  # its blocks are two ways to the same files
NEEDS = {  # commands that a page asks for in its text, or whose place the user's own files take
    "docs/tutorials/engineer.md": command_lines(ROOT / "docs" / "howto" / "train_segmentation.md")[:1],
    "docs/howto/watch.md": [
        ["pick", "--bins", "1", "--perception", "oracle", "--out", "runs/before"],
        ["pick", "--bins", "1", "--perception", "gt_masks", "--out", "runs/after"],
    ],
    "docs/howto/rooms.md": [["s3dis", "synthesize", "--out", "path/to/Stanford3dDataset_v1.2_Aligned_Version"]],
}
ELSEWHERE = {  # other shell lines, and what runs them
    "make setup": "every other target needs it",
    "make test": ".ci/run calls it",
    "make test-fast": "a part of `make test`",
    "make test-newest": "the same tests in an environment of its own, by hand",
    "make lint type": ".ci/run calls both",
    "make docs": "tests/test_site.py builds the site by the same command",
    "python -m pip install -e .[report]": "`make setup` installs all extras",
    "python -m pip install -e .[viz]": "`make setup` installs all extras",
    "git worktree add ../before 3e3d809": "a clone of one commit has no other",
    "binpick bench frame --against ../before --part tee --repeats 12 --json frame.json": (
        "tests/policies/benchmarks/builds/test_comparison.py compares builds; tests/test_site.py reads the options"
    ),
    "pip install -c constraints.txt binpick[cluster]": "`make setup` installs all extras",
    "RAY_worker_niceness=0 ray start --head --port=6379 --disable-usage-stats": "other machines are needed",
    "RAY_worker_niceness=0 ray start --address=10.0.0.1:6379 --disable-usage-stats": "other machines are needed",
    "binpick generate-scenes --part tee --count 1000 --cluster 10.0.0.1:6379": (
        "other machines are needed; tests/binpick_env/jobs/test_ray_map.py joins a cluster of this one"
    ),
    "binpick bench cluster --seconds 1.1 --spread 0.2 --megabytes 0.35 --items 100000 --start 5 --job 5": (
        "it takes two quiet cores; tests/policies/benchmarks/clusters measures without Ray"
    ),
    "rerun bin.rrd": "it opens a window; the recording is read here",
}


@dataclass(frozen=True, kw_only=True)
class ShortSoak(EnvSoak):
    """A unit of fewer steps of few parts, which no option of the command makes smaller."""

    chunk: int = 20
    num_parts: tuple[int, int] = (1, PARTS)


def empty_bin(k: int) -> Frame:
    """Return the frame of a camera over an empty bin; another one for each number."""
    K = np.array([[800.0, 0, 159.5], [0, 800.0, 119.5], [0, 0, 1]])
    T_world_cam = make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.9))
    grey, depth = np.full((240, 320), 120 + k, np.uint8), np.full((240, 320), 0.9, np.float32)
    return Frame(grey=grey, depth=depth, K=K, T_world_cam=T_world_cam)


def made_by(target: str) -> list[list[str]]:
    """Return the words after ``binpick`` in the recipe of a target of the Makefile."""
    recipe = re.search(rf"^{target}:.*\n((?:\t.*\n)+)", MAKEFILE, flags=re.MULTILINE)
    assert recipe is not None, target
    lines = re.findall(r"\$\(BIN\)/(binpick .*?)(?: \$\(ARGS\))?\n", recipe[1])
    return [words[1:] for line in lines for words in shell_lines(line)]


def stories(page: Path) -> list[Story]:
    """Return the calls of binpick of a page; those of one story run in one folder."""
    told = []
    for block in blocks(page, "sh"):
        calls: list[list[str]] = []
        for words in shell_lines(block):
            if calls_binpick(words) and " ".join(words) not in ELSEWHERE:
                calls.append(words[1:])
            elif words == ["make", "pick"]:
                calls += made_by("pick")
        told.append(calls)
    together = told if name_of(page) in ALTERNATIVES else [[call for calls in told for call in calls]]
    return [calls for calls in together if calls]


def key(words: Sequence[str]) -> str:
    """Return the name in `TINY` of a call: its command, with its subcommand if it has one."""
    both = " ".join(words[:2])
    return both if both in TINY else words[0]


def tiny(words: Sequence[str]) -> list[str]:
    """Return a call with the options of its command in `TINY`."""
    words = list(words)
    for option, value in TINY[key(words)].options.items():
        if option in words:
            words[words.index(option) + 1] = str(value)
        else:
            words += [option, str(value)]
    return words


@pytest.fixture(scope="module")
def run_story(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Story], list[Line]]]:
    """Return a function that runs calls in one folder and returns what they did; equal calls run once for all pages.

    Weights are installed for this file alone, and a soak test is short.
    """
    share_models()
    share_shaded_meshes()
    done: dict[tuple[str, ...], Line] = {}
    installed = tmp_path_factory.mktemp("weights")

    def follow(story: Story) -> list[Line]:
        folder = tmp_path_factory.mktemp("story")
        (folder / "path" / "to").mkdir(parents=True)
        trimesh.creation.box(BLOCK).export(folder / "path" / "to" / "part.stl")
        for k, name in enumerate(EMPTY_BINS):
            write_frame(empty_bin(k), folder / f"{name}.json")
        base = make_transform(translation=(-0.5, 0.0, 0.15))
        cell = {"T_world_bin": np.eye(4).tolist(), "T_world_base": base.tolist()}
        np.savetxt(folder / "cloud.xyz", np.random.default_rng(0).uniform((-0.1, -0.1, 0.8), (0.1, 0.1, 0.9), (500, 3)))
        (folder / "cell.json").write_text(json.dumps(cell))
        calls = [tuple(tiny(words)) for words in story]
        for words in calls:
            if words not in done:
                done[words] = run_in(folder, words)
        return [done[words] for words in calls]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(weights, "user_folder", lambda: installed)
        patch.setattr("policies.soak.EnvSoak", ShortSoak)
        yield follow


def run_in(folder: Path, words: tuple[str, ...]) -> Line:
    """Run a call of binpick in a folder and check what it did."""
    (module,) = (command.module for command in COMMANDS if command.name == words[0])
    finished = run(*words, cwd=folder)
    leave_cluster()  # which the end of a process does
    assert finished.returncode == 0, (words, finished.stderr)
    args = parse(importlib.import_module(module).Arguments, words[0], words[1:])
    line = Line(args=args, folder=folder, shown=finished.stdout)
    with chdir(folder):  # a part file has a label of its contents
        TINY[key(words)].check(line)
    return line


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if stories(page)], ids=name_of)
def test_every_call_does_what_the_page_says(page: Path, run_story: Callable[[Story], list[Line]]) -> None:
    for story in stories(page):
        lines = run_story([*NEEDS.get(name_of(page), []), *story])
        assert len(lines) >= len(story)


@pytest.mark.slow
def test_the_readmes_table_has_the_labels_of_a_run(run_story: Callable[[Story], list[Line]]) -> None:
    (printed,) = blocks(ROOT / "README.md", "text")
    (line,) = run_story(made_by("pick"))
    shown, now = labelled(printed), labelled(line.shown)
    assert [label for label, _ in shown] == [label for label, _ in now]
    for (label, words), (_, words_now) in zip(shown, now, strict=True):
        if label not in DEPEND_ON_RESULTS:
            assert [word.removesuffix("s") for word in words] == [word.removesuffix("s") for word in words_now], label


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_other_lines_are_run_elsewhere(page: Path) -> None:
    for block in blocks(page, "sh"):
        for words in shell_lines(block):
            if calls_binpick(words) and " ".join(words) not in ELSEWHERE:
                assert key(words[1:]) in TINY, f"say in shell_line_checks.py what {words} must do"
            elif words != ["make", "pick"]:
                assert " ".join(words) in ELSEWHERE, f"say what runs {words}"


def test_what_runs_elsewhere_exists() -> None:
    targets = set(re.findall(r"^([a-z-]+):", MAKEFILE, flags=re.MULTILINE))
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    installed = re.search(r"-e '\.\[(.*)\]'", MAKEFILE)
    assert installed is not None
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for line, reason in ELSEWHERE.items():
        assert all((ROOT / path).is_file() for path in re.findall(r"tests/\S+\.py", reason)), line
        program, *words = line.split()
        if program == "make":
            assert set(words) <= targets
        elif extra := re.search(r"\[(.*)\]", line):
            assert extra[1] in extras
            assert extra[1] in installed[1].split(",")
    for target in ("test", "lint", "type"):
        assert f"make {target} " in script


def labelled(shown: str) -> list[tuple[str, list[str]]]:
    """Return each label that starts a line, and the words that follow it."""
    pattern = r"([A-Z]+(?=  )|[A-Za-z]+(?: [A-Za-z]+)*)(.*)"
    rows = [match for text in shown.splitlines() if (match := re.match(pattern, text))]
    return [(row[1], re.findall(r"[A-Za-z][A-Za-z0-9]*", row[2])) for row in rows]
