"""A folder holds the bins of one configuration and of one network."""

import json
from pathlib import Path

import pytest

from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import CONFIG_FILE, FolderError, ensure_folder_config

FIRST = {"name": "shared.safetensors", "sha256": "0123456789ab", "training": "own"}
SECOND = {"name": "tee.safetensors", "sha256": "fedcba987654", "training": "own"}


def test_bins_of_another_network_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[dict[str, str] | None] = [FIRST]
    monkeypatch.setattr(EvaluationConfig, "weights", lambda _: found[0])
    ensure_folder_config(EvaluationConfig(), tmp_path)
    found[0] = {**FIRST, "name": "moved.safetensors"}
    ensure_folder_config(EvaluationConfig(), tmp_path)  # the same network
    found[0] = SECOND
    text = r"weights: shared.safetensors \(01234567\) there, tee.safetensors \(fedcba98\) here.*choose another folder"
    with pytest.raises(FolderError, match=text):
        ensure_folder_config(EvaluationConfig(), tmp_path)
    found[0] = None
    ensure_folder_config(EvaluationConfig(), tmp_path)  # not known


def test_a_folder_of_an_older_version_names_no_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(EvaluationConfig, "weights", lambda _: FIRST)
    ensure_folder_config(EvaluationConfig(), tmp_path)
    path = tmp_path / CONFIG_FILE
    path.write_text(json.dumps({k: v for k, v in json.loads(path.read_text()).items() if k != "weights"}))
    monkeypatch.setattr(EvaluationConfig, "weights", lambda _: SECOND)
    ensure_folder_config(EvaluationConfig(), tmp_path)
