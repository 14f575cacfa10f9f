"""Malformed command lines, and folders of results that commands read."""

import json
import shutil
from collections.abc import Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path

import numpy as np

from policies.soak.fuzz.damage import NUMBERS, choose, damaged_bytes
from policies.soak.fuzz.grammar import Case
from policies.soak.fuzz.records import damaged_record
from policies.soak.fuzz.samples import Samples

ENTRY = "policies.commands.main"  # by name, since nothing imports a command
_COMMANDS = (
    "pick", "assess", "compare", "perceive", "segment", "generate-scenes", "train-segmentation", "evaluate-pose",
    "evaluate-segmentation", "evaluate-bin", "calibrate-poses", "train-selector", "evaluate-selector", "fit-noise",
    "check-fast", "s3dis", "s3dis-table", "bench", "picture", "example", "pik", "", "--version",
)  # fmt: skip
_OPTIONS = (
    "--part", "--bins", "--seed", "--count", "--workers", "--out", "--json", "--unit", "--symmetry", "--density",
    "--bin", "--friction", "--camera-distance", "--width", "--height", "--jaw", "--sensor", "--hand-eye-mm", "--trust",
    "--max-acceleration", "--max-jerk",
    "--perception", "--network", "--min-parts", "--max-parts", "--minutes", "--steps", "--scenes", "--weights",
    "--calibration", "--camera-pose", "--bin-pose", "--teapot", "--help", "bandit", "ppo", "cell", "one", "two",
)  # fmt: skip
_VALUES = (
    *NUMBERS, "tee", "teapot", "generated:handle:4", "generated:handle:x", "generated:", "missing.stl", "part.stl", ".",
    "/", "360x260x120", "0x0x0", "1 2 3", "learned", "oracle", "good", "mm", "frame.npz", "../..", "[]", "{}", "--",
)  # fmt: skip
_STOPPERS = (["--teapot", "1"], ["--bins", "many"], ["--seed", "x"], ["--out", "part.stl"], ["--json", "."])


class RefusedError(ValueError):
    """A command ended with an error message of its own."""


class TracebackError(RuntimeError):
    """A command ended in a way that no command should."""


def command_line(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:
    """A command with options that are unknown, doubled, without meaning or without value."""
    shutil.copyfile(samples.folder / "example" / "part.stl", folder / "part.stl")
    shutil.copyfile(samples.folder / "small.npz", folder / "frame.npz")
    words = [choose(rng, _COMMANDS)]
    for _ in range(int(rng.integers(0, 5))):
        words.append(choose(rng, _OPTIONS))
        if rng.random() < 0.85:
            words.append(choose(rng, _VALUES))
    # One mistake that every command must see before its work, which would take minutes.
    words += choose(rng, _STOPPERS)
    return lambda: call_command(words, folder)


def perceive_line(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:
    """A call of perceive on the example's files, one of which is damaged, with a bin or a pose that means nothing."""
    for path in (samples.folder / "example").iterdir():
        shutil.copyfile(path, folder / path.name)
    damaged = folder / choose(rng, ("depth.png", "grey.png", "camera.json", "cell.json"))
    damaged.write_bytes(damaged_bytes(rng, damaged.read_bytes()))
    words = ["perceive", "depth.png", "--calibration", "camera.json", "--part", "part.stl", "--bin-pose", "cell.json"]
    words += choose(rng, ([], ["--grey", "grey.png"]))
    words += ["--bin", choose(rng, ("360x260x120", "0x0x0", "360", "1e9x1x1", "-1x2x3", "nan"))]
    words += choose(rng, ([], ["--depth-scale", choose(rng, NUMBERS)], ["--crop", "9", "9", "0", "-1"]))
    words += ["--json", "found.json"]
    return lambda: call_command(words, folder)


def whole_perceive_line(samples: Samples, folder: Path) -> Case:
    """Return a call of perceive on the example's files as they are; it fills the cache for later calls."""
    for path in (samples.folder / "example").iterdir():
        shutil.copyfile(path, folder / path.name)
    words = ["perceive", "depth.png", "--calibration", "camera.json", "--grey", "grey.png", "--part", "part.stl"]
    words += ["--bin-pose", "cell.json", "--bin", "360x260x120"]
    return lambda: call_command(words, folder)


def result_folder(rng: np.random.Generator, samples: Samples, folder: Path) -> Case:
    """Two folders of results, of which one has a damaged, missing or foreign file, compared or read for a fit."""
    for name in ("one", "two"):
        shutil.copytree(samples.folder / "pick", folder / name)
    path = choose(rng, sorted((folder / "two").glob("*.json")))
    kind = rng.random()
    if kind < 0.6:
        path.write_text(damaged_record(rng, path.read_text(encoding="utf-8")), encoding="utf-8")
    elif kind < 0.75:
        path.write_bytes(damaged_bytes(rng, path.read_bytes()))
    elif kind < 0.9:
        path.unlink()
    else:
        path.write_text(json.dumps({"kind": "scene", "version": choose(rng, (0, 1, 99, "x"))}), encoding="utf-8")
    html = choose(rng, ([], ["--html", "page.html"]))
    return lambda: call_command(["compare", "one", "two", "--json", "both.json", *html], folder)


def call_command(words: Sequence[str], folder: Path) -> str:
    """Call ``binpick`` in a folder, in this process, and return what it printed.

    Raises:
        RefusedError: It ended with code 1 or 2, and one message.
        TracebackError: It ended with another code, or without a message.
    """
    out, err = StringIO(), StringIO()
    main = import_module(ENTRY).main
    with chdir(folder), redirect_stdout(out), redirect_stderr(err):
        try:
            code = int(main(list(words)))
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1 if stop.code else 0
    text = err.getvalue().strip()
    if code == 0:
        return out.getvalue()
    if code not in (1, 2) or not text or "Traceback" in text:
        raise TracebackError(f"binpick {' '.join(words)} ended with code {code}: {text[-300:]}")
    raise RefusedError(text.splitlines()[-1])
