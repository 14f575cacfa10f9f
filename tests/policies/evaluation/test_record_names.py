"""Names in records of strangers: none leads out of the record's folder."""

import json
import shutil
from pathlib import Path

import pytest

from perception.runtime.records import RecordError
from policies.evaluation.records import is_picture_name, load_record

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "records_v1" / "bin_record.json"


@pytest.mark.parametrize("name", ["bin_0000_pick_01.webp", "a b.jpg", "ä.png"])
def test_names_of_pictures_are_taken(name: str) -> None:
    assert is_picture_name(name)


@pytest.mark.parametrize("name", ["../a.png", "a/b.png", "/a.png", "..\\a.png", "C:a.png", "a.txt", "..", "a.svg"])
def test_names_of_anything_else_are_not(name: str) -> None:
    assert not is_picture_name(name)


def test_a_record_that_names_a_file_elsewhere_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bin_0000.json"
    shutil.copyfile(GOLDEN, path)
    load_record(path)
    values = json.loads(path.read_text())
    path.write_text(json.dumps(values | {"before": "../../secret.png"}))
    with pytest.raises(RecordError, match=r"must be named as .* files beside the record, got '../../secret\.png'"):
        load_record(path)
