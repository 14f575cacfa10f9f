"""The works on this build, in this process."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from policies.benchmarks.builds import works
from policies.benchmarks.builds.inputs import BuildJob, save_inputs
from policies.benchmarks.builds.worker import peak_memory, timed


def test_the_first_module_that_has_a_name_counts() -> None:
    assert works.find("sqrt", "no_such_module", "json", "math") is __import__("math").sqrt
    with pytest.raises(works.MissingInterfaceError, match=r"it has no sqrt in json or no_such\.module"):
        works.find("sqrt", "json", "no_such.module")


def test_a_package_that_a_build_lacks_is_not_taken_for_an_older_interface(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "needs_more.py").write_text("import no_such_package\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="No module named 'no_such_package'"):
        works.find("sqrt", "needs_more", "math")


def test_only_known_arguments_are_passed() -> None:
    def function(part: str, measure_bin: bool = True) -> None: ...

    assert works.accepted(function, measure_bin=False, colour=1) == {"measure_bin": False}


def test_the_unit_of_a_file_reaches_the_build_where_it_is_given() -> None:
    assert works.unit_of(BuildJob(work="frame", part="part.stl", unit="inch").arguments(Path())) == {"unit": "inch"}
    assert works.unit_of(BuildJob(work="frame").arguments(Path())) == {}


def test_a_call_is_timed_and_its_result_described() -> None:
    described: list[int] = []

    def describe() -> dict[str, Any]:
        described.append(1)
        return {"values": b"a", "fact": 3, "stages": {"x": 1.0}}

    took = timed(lambda: describe)
    assert (took["fact"], took["stages"], described) == (3, {"x": 1.0}, [1])
    assert took["digest"] != timed(lambda: dict)["digest"]
    assert 0 <= took["wall"] < 1000
    assert peak_memory() > 10


@pytest.mark.slow
@pytest.mark.parametrize("work", ["frame", "camera", "attempt"])
def test_a_work_repeats_itself_on_one_input(work: str, tmp_path: Path) -> None:
    job = BuildJob(work=work, count=3, seed=31, sensor="none", repeats=1)
    save_inputs(tmp_path / "inputs.npz", job)
    function: Callable[[works.Job], works.Ready] = getattr(works, work)
    ready = function(job.arguments(tmp_path / "inputs.npz"))
    first, second = (ready(0)()() for _ in range(2))
    assert first["values"] == second["values"] != b""
    assert first["fact"] == second["fact"]
    assert first["fact"] not in (0, "no attempt")
