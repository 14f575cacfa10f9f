"""The child process that judges cases is replaced when it hangs, dies or ends by a signal."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from policies.soak.fuzz.judge import Verdict
from policies.soak.fuzz.keeper import ChildKeeper
from policies.soak.fuzz.soak import FuzzSoak
from tests.policies.soak.fuzz.toy_children import broken, toy


@pytest.fixture
def keeper(tmp_path: Path) -> Iterator[ChildKeeper]:
    keeper = ChildKeeper(toy, tmp_path, limit=0.5)
    yield keeper
    keeper.close()


@pytest.mark.slow
def test_a_child_that_ends_is_a_failure_and_is_replaced(keeper: ChildKeeper) -> None:
    first = keeper.run("well", (0,))
    assert keeper.run("well", (1,)) == first  # the same process
    assert keeper.run("signal", (2,)).text == "the process ended by signal SIGSEGV"
    assert keeper.run("exit", (3,)).text == "the process ended by exit code 7"
    other = keeper.run("well", (4,))
    assert other.outcome == "result"
    assert other != first


@pytest.mark.slow
def test_a_child_that_hangs_is_killed_with_what_it_started(keeper: ChildKeeper, tmp_path: Path) -> None:
    started = time.monotonic()
    assert keeper.run("sleep", (0,)).text == "it took more than 0.5 s"
    assert time.monotonic() - started < 10
    pid = int((tmp_path / "pid").read_text())
    time.sleep(0.2)
    state = Path(f"/proc/{pid}/stat")
    assert not state.exists() or ") Z " in state.read_text()


@pytest.mark.slow
def test_a_child_that_does_not_get_ready_is_an_error(tmp_path: Path) -> None:
    keeper = ChildKeeper(broken, tmp_path)
    with pytest.raises(RuntimeError, match=r"did not get ready: see the end of .*child\.log"):
        keeper.run("frames", (0,))


def test_the_inputs_are_spread_over_the_grammars(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def run(_: ChildKeeper, grammar: str, seed: tuple[int, ...]) -> Verdict:
        asked.append((grammar, seed))
        return Verdict(outcome=("result", "refused", "failure")[len(asked) % 3], text="it broke")

    monkeypatch.setattr(ChildKeeper, "run", run)
    soak = FuzzSoak(inputs=5, chunk=3, grammars=("frames", "scenes"), seed=9)
    assert soak.units() == ["00000", "00001"]
    result = soak.run("00001", tmp_path)
    assert asked == [("scenes", (9, 3, 4)), ("frames", (9, 4, 0)), ("scenes", (9, 5, 4))]
    assert result.counts == {"inputs": 3, "results": 1, "refused": 1}
    assert result.problems == ("frames, input 4: it broke",)
    soak.close()
    with pytest.raises(ValueError, match=r"grammars must be some of frames, .*teapots"):
        FuzzSoak(grammars=("teapots",))
    with pytest.raises(ValueError, match="inputs and chunk must be at least 1, got 0 and 20"):
        FuzzSoak(inputs=0)
