"""The version of the part generator in a folder of scenes: other versions' scenes are not mixed in."""

import json
from pathlib import Path

import pytest

from binpick_env.scenes import synthesis
from binpick_env.scenes.synthesis import MANY_PARTS, SceneConfig, ensure_folder_config, scene_settings


@pytest.mark.parametrize("part", [MANY_PARTS, "generated:clevis:3"])
def test_a_folder_of_generated_parts_belongs_to_one_version_of_their_generator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    new, older = tmp_path / "new", tmp_path / "older"
    ensure_folder_config(SceneConfig(part=part), new)
    note = json.loads((new / "scenes.json").read_text())
    assert note.pop("generator") == 1
    older.mkdir()
    (older / "scenes.json").write_text(json.dumps(note))  # as written before the version was
    ensure_folder_config(SceneConfig(part=part), older)
    monkeypatch.setattr(synthesis, "GENERATOR_VERSION", 2)
    for folder in (new, older):
        with pytest.raises(ValueError, match=r"holds scenes of another configuration \(generator: 1 there, 2 here\)"):
            ensure_folder_config(SceneConfig(part=part), folder)


def test_other_parts_have_no_version_of_the_generator() -> None:
    assert "generator" not in scene_settings(SceneConfig())
