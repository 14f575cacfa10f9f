"""`binpick`: the list of commands, their help, and what it may load."""

import errno
import importlib
import io
import json
import logging
import os
import re
import subprocess
import sys
from dataclasses import fields
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any, get_args

import pytest

from policies.commands import calibrate_poses, command_line
from policies.commands import main as entry
from policies.commands.command_line import exit_code
from policies.commands.main import main
from policies.commands.registry import COMMANDS
from policies.commands.status import StatusHandler
from policies.selection.choices import HEURISTICS
from policies.selection.selectors import SELECTORS
from tests.policies.commands.command_calls import ROOT, run_script, script, start

HEAVY = ("torch", "mujoco", "numba", "cv2", "trimesh", "scipy", "mink", "stable_baselines3", "tqdm")
NAMES = [command.name for command in COMMANDS]
SUBCOMMANDS = {
    "bench": (
        *("cell", "segmentation", "pose", "selection"),
        *("frame", "camera", "attempt", "select", "scenes", "training"),
    ),
    "s3dis": ("synthesize", "prepare", "train", "evaluate"),
    "train-selector": ("ppo", "bandit"),
}
HELP = f"""
import json
import sys
from contextlib import redirect_stdout
from io import StringIO
from policies.commands.main import main
texts = {{}}
for call in json.loads(sys.argv[1]):
    with redirect_stdout(StringIO()) as text:
        try:
            code = main([*call.split(), "--help"])
        except SystemExit as stop:
            code = stop.code or 0
    loaded = [name for name in {HEAVY} if name in sys.modules]
    if code or loaded:
        sys.exit(f"{{call}} --help ends with code {{code}} and loads {{loaded}}")
    texts[call] = text.getvalue()
print(json.dumps(texts))
"""


@pytest.fixture(autouse=True)
def _quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the levels of the packages' loggers, which other tests read."""
    monkeypatch.setattr(entry, "show_status", lambda: None)


@pytest.fixture(scope="module")
def help_texts() -> dict[str, str]:
    """Return what commands and subcommands print for --help; fail where one loads what only its work needs."""
    calls = [*NAMES, *(f"{command} {names[-1]}" for command, names in SUBCOMMANDS.items())]
    done = start([sys.executable, "-c", HELP, json.dumps(calls)], ROOT, COLUMNS="100")
    assert (done.returncode, done.stderr) == (0, "")
    texts: dict[str, str] = json.loads(done.stdout)
    return texts


@pytest.mark.slow
def test_help_is_to_the_point_and_loads_nothing_heavy(help_texts: dict[str, str]) -> None:
    for name in NAMES:
        assert help_texts[name].startswith(f"usage: binpick {name} [-h]")


def test_subcommands_are_listed(help_texts: dict[str, str]) -> None:
    for command, subcommands in SUBCOMMANDS.items():
        assert [name for name in subcommands if name not in help_texts[command]] == []
        last = f"{command} {subcommands[-1]}"
        assert help_texts[last].startswith(f"usage: binpick {last} [-h]")


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]])
def test_without_a_command_all_are_listed_in_groups(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["binpick", *arguments])
    assert main() == 0
    lines = capsys.readouterr().out.splitlines()
    for command in COMMANDS:
        assert f"  {command.name:23}{command.summary}" in lines
        assert command.group in lines
    assert max(len(line) for line in lines) <= 100


def test_the_version_is_the_packages(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(entry, "version", {"binpick": "9.8.7"}.__getitem__)
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == "binpick 9.8.7\n"

    def unknown(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(entry, "version", unknown)
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == "binpick, not installed as a package\n"


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("pik", "did you mean pick? "),
        ("evaluate_poses", "did you mean evaluate-pose"),
        ("--parts", ""),
        ("xyzzy", ""),
    ],
)
def test_an_unknown_command_is_a_mistake(name: str, hint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: there is no command {name!r}; {hint}")
    assert error.endswith("`binpick` lists them all\n")


def test_hyphens_and_underscores_are_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lost = str(tmp_path / "lost")
    for name, option in (("calibrate-poses", "--folders"), ("calibrate_poses", "--folders")):
        assert main([name, option, lost]) == 2
        assert "lost" in capsys.readouterr().err
    for count in ("--min-parts", "--min_parts"):
        assert main(["generate-scenes", count, "5", "--max-parts", "4", "--out", lost]) == 2
        assert "num_parts must be (smallest, largest)" in capsys.readouterr().err


def test_ctrl_c_while_a_command_starts_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(calibrate_poses, "run", interrupted)
    assert main(["calibrate-poses", "--folders", "anywhere"]) == 130
    assert capsys.readouterr().err == "\nstopped\n"


def test_an_unknown_option_is_a_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["pick", "--teapot"])
    assert "--teapot" in capsys.readouterr().err


@pytest.mark.slow
def test_every_script_is_a_command() -> None:
    assert sorted(path.name for path in (ROOT / "scripts").glob("*.py")) == sorted(script(name).name for name in NAMES)
    done = run_script("pick", "--bins", "0")
    assert done.returncode == 2
    status, error = done.stderr.splitlines()
    assert status.startswith("loading the simulator")
    assert error.startswith("error: bins and workers must be at least 1, got 0 and 1")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--json", "."], r"--json must name a file, got the folder \."),
        (["--json", "a.txt/b/c.json"], r"--json a\.txt/b/c\.json cannot be written: .*a\.txt is a file, and no folder"),
    ],
)
def test_a_file_that_cannot_be_written_is_said_before_the_work(
    options: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.txt").write_text("a file")
    with pytest.raises(SystemExit) as stop:
        main(["compare", "one", "two", *options])
    assert stop.value.code == 2
    assert re.search(text, capsys.readouterr().err)


@pytest.mark.parametrize(
    ("arguments", "kind"),
    [(["compare", "one", "two", "--json"], "file"), (["generate-scenes", "--out"], "folder")],
)
def test_a_device_or_a_pipe_is_not_replaced_by_a_file(
    arguments: list[str], kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(SystemExit) as stop:
        main([*arguments, str(pipe)])
    assert stop.value.code == 2
    text = f"must name a {kind}, got {pipe}, which is a device, a pipe or a socket"
    assert capsys.readouterr().err == f"error: {arguments[-1]} {text}\n"
    assert pipe.is_fifo()


def test_a_folder_that_cannot_be_written_is_said_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command_line.os, "access", lambda path, mode: False)
    with pytest.raises(SystemExit):
        main(["generate-scenes", "--out", str(tmp_path / "new")])
    assert capsys.readouterr().err == f"error: --out {tmp_path}/new cannot be written: {tmp_path} is read-only\n"
    (tmp_path / "scenes").write_text("a file")
    with pytest.raises(SystemExit):
        main(["generate-scenes", "--out", str(tmp_path / "scenes")])
    assert "--out must name a folder, got the file" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["picture", "--out", str(tmp_path)])  # whose --out is a file
    assert capsys.readouterr().err == f"error: --out must name a file, got the folder {tmp_path}\n"
    with pytest.raises(SystemExit):
        main(["example", str(tmp_path / "scenes")])
    assert capsys.readouterr().err == f"error: the argument must name a folder, got the file {tmp_path / 'scenes'}\n"


@pytest.mark.parametrize("name", ["new/a.json", "old.json"])  # a file that is there is written anew beside itself
def test_a_full_disk_is_said_before_the_work(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "old.json").write_text("{}")

    class Full(io.BytesIO):
        def write(self, data: Any) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(command_line, "TemporaryFile", lambda dir: Full())
    with pytest.raises(SystemExit) as stop:
        main(["compare", "one", "two", "--json", str(tmp_path / name)])
    assert stop.value.code == 2
    text = f"{name} cannot be written: {tmp_path}: No space left on device; name another place, or make room"
    assert text in capsys.readouterr().err


def test_a_folder_that_cannot_be_entered_is_said_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stat, access = os.stat, os.access

    def locked_stat(path: Any, *arguments: Any, **options: Any) -> os.stat_result:
        if tmp_path in Path(os.fspath(path)).parents:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return stat(path, *arguments, **options)

    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path and access(path, mode))
    monkeypatch.setattr(os, "stat", locked_stat)  # not by the folder's mode, which is nothing to root
    with pytest.raises(SystemExit):
        main(["compare", "one", "two", "--json", str(tmp_path / "new" / "a.json")])
    monkeypatch.undo()
    assert f"a.json cannot be written: {tmp_path} is read-only" in capsys.readouterr().err


def test_every_output_of_a_command_is_checked_before_its_work() -> None:
    """Options of another name that are written need a check of their own."""
    for command in COMMANDS:
        module = importlib.import_module(command.module)
        kinds = get_args(module.Arguments) or (module.Arguments,)
        names = {field.name for kind in kinds for field in fields(kind) if "Path" in str(field.type)}
        read = {
            "weights",
            "initial",
            "scenes",
            "validation",
            "folders",
            "runs",
            "frames",
            "rooms",
            "raw",
            "calibration",
            "cloud",
            "frames_in",
        }
        read |= {"compare", "opencv_python", "open3d_python", "logs", "against"}
        assert names - read <= set(command_line._FILES + command_line._FOLDERS), command.name


def test_a_terminal_without_utf_8_gets_every_line(tmp_path: Path) -> None:
    code = (
        "import sys; from policies.commands import compare; from policies.commands.main import main; "
        "compare.main = lambda options: print('GSR \\u2550 97 %') or 0; sys.exit(main(['compare']))"
    )
    done = start([sys.executable, "-c", code], ROOT, PYTHONIOENCODING="ascii", LC_ALL="C")
    assert (done.returncode, done.stdout) == (0, "GSR ? 97 %\n")


def test_expected_errors_are_one_line_and_others_are_raised(capsys: pytest.CaptureFixture[str]) -> None:
    def fail(error: BaseException) -> None:
        raise error

    assert exit_code(lambda: "done", ()) == 0
    assert capsys.readouterr().out == "done\n"
    assert exit_code(lambda: fail(OSError("disk full")), (OSError,)) == 2
    assert capsys.readouterr().err == "error: disk full\n"
    assert exit_code(lambda: fail(KeyboardInterrupt()), (OSError,), "stopped: go on") == 130
    assert capsys.readouterr().err == "\nstopped: go on\n"
    with pytest.raises(ZeroDivisionError):
        exit_code(lambda: fail(ZeroDivisionError()), (OSError,))


def test_what_the_packages_log_is_printed_above_a_progress_bar(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    logger = logging.getLogger("policies.commands.test")
    monkeypatch.setattr(logger, "propagate", False)
    logger.addHandler(StatusHandler())
    logger.setLevel(logging.INFO)
    logger.info("loading %s", "weights")
    logger.warning("a file is damaged")
    assert capsys.readouterr().err == "loading weights\nWARNING a file is damaged\n"


def test_the_heuristics_that_are_compared_are_all_that_there_are() -> None:
    assert tuple(SELECTORS) == HEURISTICS


def test_a_reader_that_goes_away_is_no_error() -> None:
    """Like `binpick pick --help | head -1`."""
    code = "import sys; from policies.commands.main import main; sys.exit(main(['pick', '--help']))"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""


def test_a_reader_that_has_gone_is_no_mistake() -> None:
    def work() -> str:
        raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        exit_code(work, (OSError,))
