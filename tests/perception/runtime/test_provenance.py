"""Where a result comes from."""

import subprocess
from pathlib import Path

import pytest

from perception.runtime import provenance
from perception.runtime.provenance import command_line, git_commit

ROOT = Path(__file__).resolve().parents[3]


def test_the_commit_is_that_of_the_checkout() -> None:
    if not (ROOT / ".git").exists():
        assert git_commit() == ""
        return
    head = subprocess.run(
        ["git", "rev-parse", "--short=12", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert git_commit().removesuffix("-dirty") == head.stdout.strip() != ""


def test_outside_of_a_checkout_there_is_no_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        provenance, "__file__", str(tmp_path / "site-packages" / "perception" / "runtime" / "provenance.py")
    )
    assert git_commit.__wrapped__() == ""


def test_a_node_of_a_cluster_names_the_commit_of_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(provenance.COMMIT, "0123456789ab-dirty")
    assert git_commit.__wrapped__() == "0123456789ab-dirty"
    monkeypatch.setenv(provenance.COMMIT, "")  # a job that was started outside of a checkout
    assert git_commit.__wrapped__() == ""


def test_a_node_of_a_cluster_names_the_command_of_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance.sys, "argv", ["/usr/bin/binpick", "s3dis-table", "--steps", "3"])
    assert command_line() == "binpick s3dis-table --steps 3"
    monkeypatch.setenv(provenance.COMMAND, "binpick pick")
    assert command_line() == "binpick pick"
