"""`binpick evaluate-bin`."""

from pathlib import Path

import pytest

from policies.commands import evaluate_bin


@pytest.mark.slow
def test_the_trials_are_printed_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--count", "1", "--min-parts", "2", "--max-parts", "2", "--width", "480", "--height", "360"]
    assert evaluate_bin.main([*options, "--json", str(tmp_path / "bins.json")]) == 0
    assert "reliable fits: 1/1" in capsys.readouterr().out
    assert '"error_mm"' in (tmp_path / "bins.json").read_text()


def test_nonsense_is_refused() -> None:
    assert evaluate_bin.main(["--count", "0"]) == 2
