"""scripts/s3dis.py from synthetic rooms to the table."""

import json
from pathlib import Path
from types import ModuleType

import pytest

from perception.s3dis.categories import SCORED
from tests.test_perception.s3dis_tree import LINES, write_tree
from tests.test_scripts import load


@pytest.fixture
def script() -> ModuleType:
    return load("s3dis.py")


def call(script: ModuleType, *arguments: object) -> int:
    return int(script.main(script.tyro.cli(script.Arguments, args=[str(argument) for argument in arguments])))


def test_synthesize_prepare_and_both_identities(
    script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw, rooms = tmp_path / "raw", tmp_path / "rooms"
    made = ("synthesize", "--out", raw, "--rooms", 3, "--seed", 31, "--density", 150, "--workers", 1)
    assert call(script, *made) == 0
    assert call(script, *made) == 0
    assert f"3 rooms in {raw}" in capsys.readouterr().out
    prepared = ("prepare", "--raw", raw, "--out", rooms, "--workers", 2, "--json", tmp_path / "made.json")
    assert call(script, *prepared) == 0
    first = json.loads((tmp_path / "made.json").read_text())
    assert (first["rooms"], first["new"], first["remarks"]) == (3, 3, [])
    assert call(script, *prepared) == 0
    assert json.loads((tmp_path / "made.json").read_text())["new"] == 0
    capsys.readouterr()
    for predictions, least in (("ground_truth", 1.0), ("merged_ground_truth_blocks", 0.99)):
        out = tmp_path / f"{predictions}.json"
        judged = ("evaluate", "--rooms", rooms, "--predictions", predictions, "--workers", 1, "--json", out)
        assert call(script, *judged) == 0
        found = json.loads(out.read_text())
        assert tuple(found["ap50"]) == SCORED
        assert min(found["mean_ap50"], found["ap25"]) >= least
        assert {value for value in found["ap50"].values() if value is not None} == {1.0} or least < 1
        assert {"ap", "rooms", "population", "git_commit", "versions"} <= found.keys()
        table = capsys.readouterr().out
        assert "SGPN (PointNet, colour)" in table
        assert predictions in table
    assert call(script, "evaluate", "--rooms", rooms, "--predictions", "ground_truth", "--population", "blocks") == 0
    assert "blocks" not in capsys.readouterr().err


def test_remarks_are_printed(script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_tree(tmp_path / "raw", {"Area_1/office_1/stairs_1": LINES})
    assert call(script, "prepare", "--raw", tmp_path / "raw", "--out", tmp_path / "out") == 0
    assert "stairs_1.txt: stairs read as clutter\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["prepare", "--raw", "broken", "--out", "out"], "office_2/Annotations/wall_1.txt, line 3 holds not 6 numbers"),
        (["prepare", "--raw", "broken", "--out", "out", "--workers", "1"], "wall_1.txt, line 3 holds not 6 numbers"),
        (["prepare", "--raw", "nowhere", "--out", "out"], "nowhere holds no Area_*/ROOM folders"),
        (["prepare", "--raw", "broken", "--out", "out", "--workers", "0"], "workers must be at least 1, got 0"),
        (["synthesize", "--out", "out", "--rooms", "0"], "rooms must be at least 1, got 0"),
        (["synthesize", "--out", "out", "--density", "-1"], "density must be positive"),
        (["evaluate", "--rooms", "nowhere", "--predictions", "ground_truth"], "nowhere holds no room of area 1, 2"),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(
    script: ModuleType,
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write_tree(tmp_path / "broken", {"Area_1/office_1/wall_1": LINES, "Area_1/office_2/wall_1": LINES + "1 2 3\n"})
    assert call(script, *arguments) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line
    assert not list((tmp_path / "out").rglob("*office_2*"))
    assert not list((tmp_path / "out").rglob("rooms.json"))


def test_a_tree_of_another_seed_is_not_mixed(
    script: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ("synthesize", "--out", tmp_path, "--rooms", 1, "--density", 20, "--workers", 1)
    assert call(script, *common, "--seed", 31) == 0
    assert call(script, *common, "--seed", 32) == 2
    assert "seed: 31 there, 32 here" in capsys.readouterr().err


def test_ctrl_c_says_how_to_go_on(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(script, "find_raw_rooms", interrupted)
    assert call(script, "prepare", "--raw", tmp_path, "--out", tmp_path) == 130
    assert "the same command goes on from there" in capsys.readouterr().err
