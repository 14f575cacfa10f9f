"""A few inputs of each grammar, in this process."""

from pathlib import Path

import numpy as np
import pytest

from policies.commands import main
from policies.soak.fuzz import samples as samples_module
from policies.soak.fuzz.grammars import GRAMMARS
from policies.soak.fuzz.judge import judge
from policies.soak.fuzz.samples import Samples

EACH = 4  # number of inputs of each grammar


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Samples:
    return Samples.in_folder(tmp_path_factory.mktemp("fuzz") / "samples")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numpy's, on values that mean nothing
@pytest.mark.parametrize("name", GRAMMARS)
def test_malformed_inputs_give_a_result_or_an_error_of_our_own(
    name: str, samples: Samples, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(main, "show_status", lambda: None)
    failures = []
    for k in range(EACH):
        folder = tmp_path / str(k)
        folder.mkdir()
        verdict = judge(GRAMMARS[name](np.random.default_rng([5, k]), samples, folder), folder)
        failures += [verdict.text] if verdict.outcome == "failure" else []
    assert failures == []


@pytest.mark.slow
def test_the_whole_samples_are_accepted(samples: Samples) -> None:
    from perception.boundary import extract_boundary
    from perception.segmentation.scene import BoundaryScene
    from policies.evaluation.comparison import load_run

    assert len(extract_boundary(samples.frame(), samples.workspace)) > 100
    assert len(BoundaryScene.load(samples.folder / "scene.npz").T_cam_parts) == 2
    assert len(load_run(samples.folder / "pick").records) == 2


def test_samples_are_whole_or_absent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(folder: Path) -> None:
        (folder / "half").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(samples_module, "_make", fail)
    with pytest.raises(KeyboardInterrupt):
        Samples.in_folder(tmp_path / "samples")
    assert list(tmp_path.iterdir()) == []
