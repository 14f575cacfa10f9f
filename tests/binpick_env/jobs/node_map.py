"""A map over a cluster without one: each index is computed as a node does it, but in this process."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

from binpick_env.jobs import node
from binpick_env.jobs.build import build
from binpick_env.jobs.cluster_job import Job, SentFile
from binpick_env.jobs.workers import Cluster
from perception.runtime.file_work import FolderWork, without_inputs
from perception.runtime.job_files import use_job_files

Result = TypeVar("Result")


def node_map(
    work: Callable[[int], Result],
    indices: Sequence[int],
    cluster: Cluster,
    initializer: Callable[..., None] | None = None,
    initargs: tuple[Any, ...] = (),
) -> Iterator[Result]:
    """Yield the results as `map_on_cluster` does, the last index first."""
    work, inputs = without_inputs(work)
    job = Job.of(work, initializer, initargs, (path for paths in inputs.values() for path in paths))
    key = uuid4().hex
    for index in reversed(indices):
        files = [SentFile.read(path) for path in inputs.get(index, ())]
        try:
            outcome = node.compute(key, dict(build()), lambda: job, index, lambda files=files: files)
        finally:
            use_job_files(None)
            node._loaded = None
        if isinstance(work, FolderWork):
            work.keep(outcome.files)
        yield outcome.result


@contextmanager
def distant_node(*folders: Path) -> Iterator[None]:
    """Let a node have neither some folders nor the working directory while it computes."""
    compute = node.compute
    hidden = {folder.absolute(): folder.absolute().with_name(f"{folder.name} hidden") for folder in folders}

    def elsewhere(*arguments: Any) -> Any:
        for folder, away in hidden.items():
            folder.rename(away)
        try:
            with chdir("/"):
                return compute(*arguments)
        finally:
            for folder, away in hidden.items():
                away.rename(folder)

    node.compute = elsewhere
    try:
        yield
    finally:
        node.compute = compute
