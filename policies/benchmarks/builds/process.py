"""One build of the project, which works in a process of its own."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from policies.benchmarks.pose_peers import thread_variables

_FOLDER = Path(__file__).parent
_LAUNCH = "import runpy, sys; runpy.run_path(sys.argv[1])['serve'](*sys.argv[2:])"
_PACKAGES = ("perception", "binpick_env", "policies")


class BuildError(RuntimeError):
    """A build cannot do the work."""


def require_checkout(folder: Path) -> None:
    """Raise unless a folder is a checkout of the project.

    Raises:
        ValueError: It is not; the text says what is missing.
    """
    missing = [name for name in _PACKAGES if not (folder / name).is_dir()]
    if missing:
        raise ValueError(
            f"{folder} must be a checkout of the project, a folder with {', '.join(_PACKAGES)}; it has no "
            f"{' and no '.join(missing)}. `git worktree add FOLDER COMMIT` makes one"
        )


class BuildProcess:
    """The process of one build; a context, at whose end the process is ended.

    Attributes:
        checkout: Folder of the build.
        imported: Peak memory once everything was imported and prepared, before the first input [MB].
    """

    def __init__(self, checkout: Path, work: str, arguments: Mapping[str, Any]) -> None:
        """Start the build and wait until it is ready.

        Args:
            checkout: Folder of the build.
            work: Name of the work.
            arguments: What the work depends on; see `BuildJob.arguments`.

        Raises:
            ValueError: The folder is no checkout, or its build has no interface that the work needs.
            BuildError: The build failed; the text ends with the last line of its error output.
        """
        require_checkout(checkout)
        self.checkout = checkout.resolve()
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 - closed at exit
        threads = thread_variables(int(arguments["threads"]))
        told = (_FOLDER / "worker.py", _FOLDER / "works.py", work, json.dumps(dict(arguments)))
        self._process = subprocess.Popen(
            [sys.executable, "-c", _LAUNCH, *map(str, told)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            cwd=self.checkout,
            env=os.environ | threads | {"PYTHONPATH": str(self.checkout)},
        )
        try:
            ready = self._answer()
            self._require_own(ready["packages"])
        except BaseException:
            self.close()
            raise
        self.imported = float(ready["memory"])

    def __enter__(self) -> "BuildProcess":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def work(self, index: int) -> dict[str, Any]:
        """Do the work on one input and return what `worker.timed` does.

        Raises:
            BuildError: The build failed.
        """
        self._ask({"index": index})
        return self._answer()

    def finish(self) -> float:
        """End the process and return its peak memory [MB]; it is that of the whole process.

        Raises:
            BuildError: The build failed.
        """
        self._ask({})
        return float(self._answer()["memory"])

    def close(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        self._process.communicate()
        self._errors.close()

    def _ask(self, request: dict[str, Any]) -> None:
        assert self._process.stdin is not None  # a pipe was asked for
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:  # it has ended; reading its answer says why
            pass

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None  # a pipe was asked for
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            self._errors.seek(0)
            last = (self._errors.read().strip().splitlines() or ["no output"])[-1]
            raise BuildError(f"the build in {self.checkout} failed with exit code {self._process.returncode}: {last}")
        message: dict[str, Any] = json.loads(line)
        if "missing" in message:
            raise ValueError(f"the build in {self.checkout} cannot do this work: {message['missing']}")
        return message

    def _require_own(self, packages: list[str]) -> None:
        """Raise unless the packages were imported from the checkout.

        Raises:
            BuildError: Another installation was imported.
        """
        others = [path for path in (Path(name).resolve() for name in packages) if self.checkout not in path.parents]
        if others:
            raise BuildError(f"the build in {self.checkout} imported {others[0]}; uninstall that package")
