"""Labels of parts: safe in file names, different for files of different content."""

from pathlib import Path

import pytest

from binpick_env.parts.label import part_label


@pytest.mark.parametrize(
    ("name", "label"),
    [("tee", "tee"), ("generated:hex_bolt:17", "generated-hex_bolt-17"), ("nowhere/my part.stl", "my-part")],
)
def test_names_are_their_own_labels(name: str, label: str) -> None:
    assert part_label(name) == label


def test_two_files_of_one_name_have_different_labels_and_one_content_has_one(tmp_path: Path) -> None:
    paths = [tmp_path / folder / "tee v2.final.stl" for folder in ("a", "b", "c")]
    for path, text in zip(paths, ("one", "two", "one"), strict=True):
        path.parent.mkdir()
        path.write_text(text)
    first, second, third = map(part_label, paths)
    assert first == third != second
    assert first.startswith("tee-v2.final-")
    assert not set(first) & set(' :/\\"*?<>|')
