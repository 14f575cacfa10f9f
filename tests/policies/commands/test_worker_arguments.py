"""Commands whose work is a map over scenes or bins take the same options for where it is computed."""

import importlib
from dataclasses import fields
from typing import Any

import pytest

from binpick_env.jobs.workers import Cluster
from policies.commands.command_line import parse
from policies.commands.generate_scenes import Arguments, run
from policies.commands.registry import COMMANDS
from policies.commands.train_selector import Bandit
from policies.commands.worker_arguments import WorkerArguments


def options_of(name: str) -> Any:
    (module,) = (command.module for command in COMMANDS if command.name == name)
    return importlib.import_module(module).Arguments


def test_every_long_command_has_a_cluster() -> None:
    counted = [
        name for name in (command.name for command in COMMANDS)
        if hasattr(options_of(name), "__dataclass_fields__") and "workers" in {f.name for f in fields(options_of(name))}
    ]  # fmt: skip
    assert len(counted) > 8
    assert [name for name in counted if not issubclass(options_of(name), WorkerArguments)] == ["s3dis-table"]
    assert issubclass(Bandit, WorkerArguments)


def test_without_a_cluster_processes_are_counted() -> None:
    assert parse(Arguments, "generate-scenes", ["--workers", "3"]).places() == 3


@pytest.mark.parametrize("address", ["local", "auto", "10.0.0.1:6379"])
def test_a_cluster_is_named_by_its_address(address: str) -> None:
    args = parse(Arguments, "generate-scenes", ["--workers", "3", "--cluster", address])
    assert args.places() == Cluster(address=address, workers=3)


def test_an_address_without_a_port_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(Arguments(cluster="head")) == 2
    assert capsys.readouterr().err == "error: cluster must be local, auto or host:port, got 'head'\n"
