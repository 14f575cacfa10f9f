"""The collection of garbage is paused, and goes on as it was."""

import gc
from collections.abc import Iterator

import numpy as np
import pytest

from perception import pipeline
from perception.boundary import BoundarySettings
from perception.frame import Workspace
from perception.pipeline import Pipeline
from perception.runtime.garbage import collection_paused
from perception.segmentation.predictor import SegmentationPredictor
from tests.perception.pose.observed_part import ell


@pytest.fixture(autouse=True)
def enabled() -> Iterator[None]:
    was = gc.isenabled()
    gc.enable()
    yield
    (gc.enable if was else gc.disable)()


def test_it_is_paused_and_goes_on() -> None:
    with collection_paused():
        assert not gc.isenabled()
        with collection_paused():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()


def test_the_last_of_several_threads_lets_it_go_on() -> None:
    """The first thread ends its pause in the middle of the second one's."""
    first, second = collection_paused(), collection_paused()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert not gc.isenabled()
    second.__exit__(None, None, None)
    assert gc.isenabled()


def test_it_goes_on_after_an_error() -> None:
    with pytest.raises(KeyError), collection_paused():
        raise KeyError
    assert gc.isenabled()


def test_a_program_that_has_switched_it_off_keeps_it_off() -> None:
    gc.disable()
    with collection_paused():
        pass
    assert not gc.isenabled()


def test_a_pipeline_is_made_while_it_is_paused(monkeypatch: pytest.MonkeyPatch) -> None:
    paused: list[bool] = []
    monkeypatch.setattr(pipeline, "PoseEstimator", lambda *_: paused.append(not gc.isenabled()))
    monkeypatch.setattr(SegmentationPredictor, "for_part", lambda _: None)
    workspace = Workspace(T_world_bin=np.eye(4), inner_size=(0.3, 0.2, 0.1))
    Pipeline.for_part(ell(), workspace, boundary=BoundarySettings())
    assert paused == [True]
    assert gc.isenabled()
