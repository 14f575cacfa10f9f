"""Commands whose work is a map over scenes or bins take the same options for where it is computed."""

import importlib
from dataclasses import fields, is_dataclass
from typing import Any, get_args

import pytest

from binpick_env.jobs.workers import Cluster
from policies.commands.bench import Selection
from policies.commands.command_line import parse
from policies.commands.generate_scenes import Arguments, run
from policies.commands.registry import COMMANDS
from policies.commands.s3dis import Evaluate, Prepare, Synthesize
from policies.commands.train_selector import Bandit, Ppo
from policies.commands.worker_arguments import WorkerArguments


def options() -> list[Any]:
    """Return the classes of the options of all commands and their subcommands."""
    arguments = [importlib.import_module(command.module).Arguments for command in COMMANDS]
    return [each for one in arguments for each in get_args(one) or (one,) if is_dataclass(each)]


def test_every_long_command_has_a_cluster() -> None:
    counted = [each for each in options() if "workers" in {field.name for field in fields(each)}]
    assert len(counted) > 12
    # bench measures the processes of one machine.
    assert [each for each in counted if not issubclass(each, WorkerArguments)] == [Selection]
    assert {Ppo, Bandit, Synthesize, Prepare, Evaluate} <= set(counted)


def test_without_a_cluster_processes_are_counted() -> None:
    assert parse(Arguments, "generate-scenes", ["--workers", "3"]).places() == 3


@pytest.mark.parametrize("address", ["local", "auto", "10.0.0.1:6379"])
def test_a_cluster_is_named_by_its_address(address: str) -> None:
    args = parse(Arguments, "generate-scenes", ["--workers", "3", "--cluster", address])
    assert args.places() == Cluster(address=address, workers=3)


def test_an_address_without_a_port_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(Arguments(cluster="head")) == 2
    assert capsys.readouterr().err == "error: cluster must be local, auto or host:port, got 'head'\n"
