"""Jobs that are killed, on full disks and beside each other, on toy programs in place of commands."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from policies.soak.kill import disk, process
from policies.soak.kill import soak as soak_module
from policies.soak.kill.disk import small_disk
from policies.soak.kill.jobs import JOBS, SCENES, KilledJob
from policies.soak.kill.process import Ended, JobProcess
from policies.soak.kill.soak import KillSoak

TOY = KilledJob(name="pick", words=("toy", "{out}"))
# Twelve numbers in twelve files, each whole or absent, as every command of binpick writes them.
WELL = """
import os, sys, time
from pathlib import Path
out = Path(sys.argv[2])
out.mkdir(parents=True, exist_ok=True)
try:
    for k in range(12):
        if not (out / f"{k}.json").exists():
            draft = out / f".{k}.{os.getpid()}"
            try:
                draft.write_text(str(k) + " " * 3000)
                os.replace(draft, out / f"{k}.json")
            finally:
                draft.unlink(missing_ok=True)
            time.sleep(0.02)
except OSError as error:
    print(f"error: {out} cannot be written: {error}")
    sys.exit(2)
"""
# A thirteenth file stays half-written until the job ends, so that a kill at any moment leaves it so.
HALF = (
    WELL.replace("try:", '(out / "last.json").write_text("[1,")\ntry:', 1) + '(out / "last.json").write_text("[1]")\n'
)
RAISING = WELL.replace("    sys.exit(2)", "    raise")
Use = Callable[[str], KillSoak]


@pytest.fixture
def use(monkeypatch: pytest.MonkeyPatch) -> Use:
    """Return a function that lets a program stand for a command, and returns a soak test of it."""

    def program(text: str) -> KillSoak:
        monkeypatch.setattr(process, "_PROGRAM", text)
        monkeypatch.setattr(soak_module, "JOBS", (TOY,))
        monkeypatch.setattr(soak_module, "EARLY", 0.0)
        monkeypatch.setattr(soak_module, "REHEARSALS", 1)
        return KillSoak(kills=1, jobs=("pick",))

    return program


@pytest.mark.slow
def test_a_killed_job_that_writes_whole_files_is_resumed_to_the_same_bits(use: Use, tmp_path: Path) -> None:
    soak = use(WELL)
    result = soak.run("00000-kill-pick", tmp_path)
    assert result.problems == ()
    assert result.counts["kills"] == 1
    assert not list(tmp_path.glob("work*"))


@pytest.mark.slow
def test_half_written_files_are_found(use: Use, tmp_path: Path) -> None:
    result = use(HALF).run("00000-kill-pick", tmp_path)
    assert any("is not whole" in problem for problem in result.problems)


@pytest.mark.slow
def test_a_job_that_is_not_the_same_twice_is_found(use: Use, tmp_path: Path) -> None:
    result = use(WELL.replace("str(k)", "str(time.time())")).run("00000-kill-pick", tmp_path)
    (problem,) = result.problems
    assert problem.startswith("the resumed job's results differ in 12 places: 0.json: ")


@pytest.mark.slow
@pytest.mark.parametrize("mounts", [True, False])
def test_a_full_disk_is_an_error_message_and_the_job_is_resumed(
    mounts: bool, use: Use, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not mounts:
        monkeypatch.setattr(disk, "_call", lambda *_: False)
    result = use(WELL).run("00000-disk-pick", tmp_path)
    assert result.problems == ()
    assert sum(count for name, count in result.counts.items() if name.startswith("disks, ")) == 1
    assert result.counts["disks that were full"] == 1


@pytest.mark.slow
def test_a_traceback_on_a_full_disk_is_found(use: Use, tmp_path: Path) -> None:
    result = use(RAISING).run("00000-disk-pick", tmp_path)
    assert any(problem.startswith("on a full disk: it ended with code 1: OSError") for problem in result.problems)


def test_two_writers_of_whole_files_agree(use: Use, tmp_path: Path) -> None:
    result = use(WELL).run("00000-writers-pick", tmp_path)
    assert (result.counts, result.problems) == ({"pairs of writers": 1}, ())


def test_a_job_that_fails_undisturbed_is_an_error(use: Use, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="pick fails undisturbed: error: no such part"):
        use("print('error: no such part'); raise SystemExit(2)").run("00000-kill-pick", tmp_path)


def test_a_hung_job_is_killed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(process, "_PROGRAM", "import time; time.sleep(60)")
    monkeypatch.setattr(process, "LONGEST", 0.3)
    started = time.monotonic()
    ended = JobProcess([], tmp_path / "log", tmp_path / "cache").wait()
    assert ended.code is None
    assert ended.complaint() == "it did not end within 0.3 s"
    assert time.monotonic() - started < 5


@pytest.mark.parametrize(
    ("ended", "complaint"),
    [
        (Ended(code=0, log="done"), ""),
        (Ended(code=2, log="error: the disk is full"), ""),
        (Ended(code=-11, log=""), "it ended with code -11: nothing printed"),
        (Ended(code=2, log="Traceback\nKeyError: 3"), "it ended with code 2: KeyError: 3"),
    ],
)
def test_a_command_ends_well_or_with_a_message(ended: Ended, complaint: str) -> None:
    assert ended.complaint() == complaint


def test_a_small_disk_is_full_and_grows(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 5000, 1250) as small:
        if small.how == "tmpfs":
            with pytest.raises(OSError, match="No space left"):
                (small.folder / "a").write_bytes(bytes(20_000))
            small.grow()
            (small.folder / "a").write_bytes(bytes(20_000))
        assert small.largest_file is None or small.largest_file == 1250
    assert not (tmp_path / "disk" / "a").exists() or small.how != "tmpfs"


def test_units_of_a_shorter_run_come_first_and_every_job_has_its_turn() -> None:
    units = list(KillSoak(kills=100).units())
    assert units[:7] == list(KillSoak(kills=6).units())
    assert [sum(f"-{what}-" in unit for unit in units) for what in ("kill", "disk", "writers")] == [100, 20, 5]
    for what in ("kill", "disk", "writers"):
        assert {unit.split("-", 2)[2] for unit in units if f"-{what}-" in unit} == {job.name for job in JOBS}


def test_jobs_are_commands_with_a_folder() -> None:
    for job in JOBS:
        words = job.command(Path("results"), Path("scenes"))
        assert words[words.index("--out") + 1] == "results"
        assert job.needs_scenes == ("scenes" in words)
    assert sum(job.needs_scenes for job in JOBS) == 1
    assert not SCENES.needs_scenes


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match="kills must be at least 1, got 0"):
        KillSoak(kills=0)
    with pytest.raises(ValueError, match=r"jobs must be some of pick, .*, got \('teapot',\)"):
        KillSoak(jobs=("teapot",))


@pytest.mark.slow
def test_a_killed_command_is_resumed_to_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("s3dis", "synthesize", "--rooms", "2", "--density", "5", "--workers", "1", "--out", "{out}")
    monkeypatch.setattr(soak_module, "JOBS", (KilledJob(name="rooms", words=words),))
    monkeypatch.setattr(soak_module, "REHEARSALS", 1)
    result = KillSoak(kills=1, jobs=("rooms",), seed=2).run("00000-kill-rooms", tmp_path)
    assert result.problems == ()
