"""The soak test of killed jobs, of full disks, and of two writers in one folder."""

import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from policies.soak.choices import SoakKind
from policies.soak.kill.disk import small_disk
from policies.soak.kill.facts import differing, facts_of
from policies.soak.kill.jobs import JOBS, SCENES, KilledJob
from policies.soak.kill.process import JobProcess
from policies.soak.unit import UnitResult

EARLY = 0.15  # share of the kills at any moment from the start of the process on; the others are during its work
DISKS, WRITERS = 5, 20  # after so many kills, a full disk, and two writers
REHEARSALS = 2  # number of undisturbed runs; the last has a full cache, as the disturbed ones have
_SHOWN = 3  # number of differing places that a problem names


@dataclass(frozen=True, kw_only=True)
class KillSoak:
    """Disturbed jobs, each resumed and compared bit by bit with an undisturbed one.

    Attributes:
        kills: Number of kills; there is a full disk for every five, and two writers for every twenty.
        seed: Seed; disturbance k is drawn from (seed, k).
        jobs: Names of the jobs, taken in turn.
    """

    kind: ClassVar[SoakKind] = "kill"
    kills: int = 100
    seed: int = 0
    jobs: tuple[str, ...] = tuple(job.name for job in JOBS)

    def __post_init__(self) -> None:
        if self.kills < 1:
            raise ValueError(f"kills must be at least 1, got {self.kills}")
        known = [job.name for job in JOBS]
        if not self.jobs or not set(self.jobs) <= set(known):
            raise ValueError(f"jobs must be some of {', '.join(known)}, got {self.jobs}")

    def settings(self) -> dict[str, Any]:
        """Return what the result of a unit depends on; the number of kills is no part of it."""
        return {"seed": self.seed, "jobs": self.jobs}

    def units(self) -> Sequence[str]:
        """Return the names of the units: the number, what is done, and the job."""
        names = []
        for k in range(self.kills):
            names.append(f"{k:05d}-kill-{self._job(k).name}")
            if k % DISKS == DISKS - 1:
                names.append(f"{k:05d}-disk-{self._job(k // DISKS).name}")
            if k % WRITERS == WRITERS - 1:
                names.append(f"{k:05d}-writers-{self._job(k // WRITERS).name}")
        return names

    def run(self, unit: str, folder: Path) -> UnitResult:
        """Disturb a job, resume it, and compare."""
        number, what, name = unit.split("-", 2)
        job = next(job for job in JOBS if job.name == name)
        rng = np.random.default_rng([self.seed, int(number), ("kill", "disk", "writers").index(what)])
        bench = _Bench(folder)
        disturb = {"kill": bench.kill, "disk": bench.fill, "writers": bench.write_twice}[what]
        counts, problems = disturb(job, rng)
        return UnitResult(name=unit, counts=counts, problems=tuple(problems))

    def close(self) -> None:
        """Nothing is open between units."""

    def _job(self, k: int) -> KilledJob:
        name = self.jobs[k % len(self.jobs)]
        return next(job for job in JOBS if job.name == name)


Found = tuple[dict[str, int], list[str]]


class _Bench:
    """The folders in which jobs are run."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._cache = folder / "cache"

    # --- disturbances ----------------------------------------------------------------------------------------------

    def kill(self, job: KilledJob, rng: np.random.Generator) -> Found:
        """Kill a job at a random moment."""
        reference, duration = self._reference(job)
        early = bool(rng.random() < EARLY)
        moment = float(rng.uniform(0.0, duration if early else 0.5 * duration))
        with self._work_folder() as work:
            out = work / "out"
            running = self._start(job, out, work).kill_after(moment, None if early else out)
            problems = [f"after the kill: {problem}" for problem in _unreadable(out)]
            problems += self._resumed(job, out, work, reference)
        return {"kills": 1, "kills while it ran": int(running)}, problems

    def fill(self, job: KilledJob, rng: np.random.Generator) -> Found:
        """Run a job on a disk that has room for a part of its results."""
        reference, _ = self._reference(job)
        sizes = [path.stat().st_size for path in reference.rglob("*") if path.is_file()]
        room = float(rng.uniform(0.1, 0.9))
        limits = int(room * sum(sizes)), max(int(room * max(sizes)), 1)
        with self._work_folder() as work, small_disk(work / "disk", *limits) as disk:
            out = disk.folder / "out"
            ended = self._start(job, out, work, disk.largest_file).wait()
            problems = [f"on a full disk: {ended.complaint()}"] if ended.complaint() else []
            if ended.code == 2 and str(out) not in ended.log:
                problems.append(f"on a full disk: the message names no file: {ended.log.strip()[-200:]}")
            problems += [f"after a full disk: {problem}" for problem in _unreadable(out)]
            problems += [f"after a full disk: {path.name} is left behind" for path in out.rglob(".*")]
            disk.grow()
            problems += self._resumed(job, out, work, reference)
            return {f"disks, {disk.how}": 1, "disks that were full": int(ended.code == 2)}, problems

    def write_twice(self, job: KilledJob, rng: np.random.Generator) -> Found:
        """Run a job twice at the same time in the same folder."""
        reference, duration = self._reference(job)
        with self._work_folder() as work:
            out = work / "out"
            first = self._start(job, out, work)
            time.sleep(float(rng.uniform(0.0, 0.2 * duration)))
            both = first, self._start(job, out, work, log="second.log")
            problems = [f"of two writers: {text}" for each in both if (text := each.wait().complaint())]
            problems += self._resumed(job, out, work, reference)
        return {"pairs of writers": 1}, problems

    # --- jobs ------------------------------------------------------------------------------------------------------

    def _resumed(self, job: KilledJob, out: Path, work: Path, reference: Path) -> list[str]:
        """Run the same command again, and return what is wrong with its end and its results."""
        ended = self._start(job, out, work).wait()
        if ended.code != 0:
            return [f"the resumed job {ended.complaint() or 'refuses: ' + ended.log.strip()[-300:]}"]
        places = differing(facts_of(reference), facts_of(out))
        if not places:
            return []
        return [f"the resumed job's results differ in {len(places)} places: {'; '.join(places[:_SHOWN])}"]

    def _reference(self, job: KilledJob) -> tuple[Path, float]:
        """Return the results of an undisturbed job, and its duration [s]; it is done once."""
        kept = self._folder / "reference" / job.name
        if not kept.exists():
            if job.needs_scenes:
                self._reference(SCENES)
            for _ in range(REHEARSALS):
                with self._work_folder() as work:
                    started = time.monotonic()
                    ended = self._start(job, work / "out", work).wait()
                    duration = time.monotonic() - started
                    if ended.code != 0:
                        raise RuntimeError(f"{job.name} fails undisturbed: {ended.log.strip()[-500:]}")
                    (work / "seconds").write_text(str(duration), encoding="utf-8")
                    kept.parent.mkdir(parents=True, exist_ok=True)
                    if kept.exists():
                        shutil.rmtree(kept)
                    shutil.copyfile(work / "seconds", kept.with_name(f"{job.name}.seconds"))
                    (work / "out").replace(kept)
        return kept, float(kept.with_name(f"{job.name}.seconds").read_text(encoding="utf-8"))

    def _start(
        self, job: KilledJob, out: Path, work: Path, largest_file: int | None = None, log: str = "first.log"
    ) -> JobProcess:
        scenes = self._folder / "reference" / SCENES.name
        return JobProcess(job.command(out, scenes), work / log, self._cache, largest_file)

    @contextmanager
    def _work_folder(self) -> Iterator[Path]:
        self._folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="work", dir=self._folder) as name:
            yield Path(name).resolve()


def _unreadable(out: Path) -> list[str]:
    """Return why the files of a folder cannot be read; a draft of a killed process is none of them."""
    problems = []
    for path in sorted(path for path in out.rglob("*") if path.is_file() and not path.name.startswith(".")):
        with tempfile.TemporaryDirectory() as alone:
            shutil.copyfile(path, Path(alone) / path.name)
            try:
                facts_of(Path(alone))
            except Exception as error:  # whatever reading half a file raises
                problems.append(f"{path.name} is not whole ({error})")
    return problems
