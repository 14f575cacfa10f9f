"""Settings that were renamed: files of the previous version are read, and its names are written for one version."""

import json
from pathlib import Path

import pytest

from binpick_env.evaluation.pose import evaluation
from binpick_env.evaluation.pose.calibration import plain_coefficients
from binpick_env.jobs.folder_config import ensure_same_config
from perception.pose.verification.confidence import ConfidenceConfig


def settings_of(path: Path) -> dict[str, object]:
    values = evaluation._flat(evaluation.PoseEvaluationConfig().settings())
    ensure_same_config(path, values, "an evaluation of poses", evaluation.RENAMED)
    return values


def test_a_folder_of_the_previous_version_is_resumed(tmp_path: Path) -> None:
    path = tmp_path / "pose_evaluation.json"
    values = settings_of(path)
    assert set(evaluation.RENAMED.values()) <= set(values)
    written = json.loads(path.read_text())
    assert set(written) == set(values) | set(evaluation.RENAMED)
    for old, new in evaluation.RENAMED.items():
        assert written[old] == written[new] == values[new]
    previous = {name: value for name, value in written.items() if name not in evaluation.RENAMED.values()}
    for names in (written, previous):
        path.write_text(json.dumps(names))
        settings_of(path)
    path.write_text(json.dumps(previous | {"method.estimator.twins.most": 9}))
    with pytest.raises(ValueError, match=r"method\.estimator\.near_symmetry\.most: 9 there, 3 here"):
        settings_of(path)


def test_coefficients_have_the_previous_name_too() -> None:
    plain = plain_coefficients(ConfidenceConfig(score_drop=0.5))
    assert plain["firmness"] == plain["score_drop"] == 0.5
    assert set(plain) == {*vars(ConfidenceConfig()), "firmness"}


def test_results_hold_the_previous_names_too() -> None:
    config = evaluation.PoseEvaluationConfig()
    plain, settings = evaluation._flat(config.plain()), evaluation._flat(config.settings())
    assert plain == settings | {old: settings[new] for old, new in evaluation.RENAMED.items()}
