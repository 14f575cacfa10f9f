"""Names of generated parts: round trips, ranges of sizes, the split into training and held-out parts, errors."""

from collections import Counter

import pytest

from binpick_env.parts import generate_part, load_part
from binpick_env.parts.families import (
    FAMILIES,
    HELD_OUT_FAMILIES,
    TRAINING_FAMILIES,
    GeneratedName,
    held_out_parts,
    is_generated,
    parse_name,
    training_parts,
)
from binpick_env.parts.label import part_label
from binpick_env.scenes import SceneConfig
from binpick_env.scenes.synthesis import scene_settings


@pytest.mark.parametrize("name", ["generated:hex_bolt:17", "generated:clevis:0:50-110"])
def test_names_round_trip(name: str) -> None:
    assert is_generated(name)
    assert str(parse_name(name)) == name
    assert load_part(name).source == name == load_part(name).model.name


def test_generated_part_is_the_one_of_its_name() -> None:
    assert generate_part("clevis", 3) is load_part("generated:clevis:3")
    assert generate_part("clevis", 3, (0.05, 0.11)) is load_part("generated:clevis:3:50-110")
    assert load_part("generated:clevis:3", density=1000.0).density == 1000.0
    assert load_part("generated:hex_nut:0", symmetry="none").model.symmetry.order == 1


def test_range_of_sizes_is_kept_and_the_shape_does_not_depend_on_it() -> None:
    small, large = (load_part(f"generated:hex_bolt:3:{sizes}").model for sizes in ("50-60", "100-110"))
    assert 0.05 <= small.d_max <= 0.06
    assert 0.10 <= large.d_max <= 0.11
    ratio = large.d_max / small.d_max
    assert large.mesh.volume == pytest.approx(small.mesh.volume * ratio**3)


def test_no_family_is_both_trained_and_held_out() -> None:
    assert not set(TRAINING_FAMILIES) & set(HELD_OUT_FAMILIES)
    assert set(TRAINING_FAMILIES) | set(HELD_OUT_FAMILIES) == set(FAMILIES)
    assert len(FAMILIES) >= 30
    assert len(HELD_OUT_FAMILIES) >= 8


def test_lists_of_parts_are_even_and_begin_alike() -> None:
    names = training_parts(100)
    assert names[:10] == training_parts(10)
    assert len(set(names)) == 100
    counts = Counter(parse_name(name).family for name in names)
    assert set(counts) == set(TRAINING_FAMILIES)
    assert max(counts.values()) - min(counts.values()) <= 1
    held_out = [parse_name(name) for name in held_out_parts(25, (0.05, 0.11))]
    assert {each.family for each in held_out} == set(HELD_OUT_FAMILIES)
    assert {each.d_max_range for each in held_out} == {(0.05, 0.11)}


def test_settings_of_scenes_hold_the_name_alone() -> None:
    settings = scene_settings(SceneConfig(part="generated:hook:2"))
    assert settings["part"] == "generated:hook:2"
    assert "file" not in settings


def test_label_of_a_part_names_a_folder_on_every_file_system() -> None:
    assert part_label("generated:hex_bolt:17") == "generated-hex_bolt-17"
    assert part_label("generated:hex_bolt:17:50-110") == "generated-hex_bolt-17-50-110"


def test_wrong_names_are_refused_with_the_families_that_exist() -> None:
    with pytest.raises(ValueError, match=r"family must be one of stepped_shaft, .*heat_sink, got 'gear'"):
        load_part("generated:gear:0")
    with pytest.raises(ValueError, match=r"named generated:FAMILY:INDEX .*hex_bolt.*got 'generated:hex_bolt'"):
        load_part("generated:hex_bolt")
    with pytest.raises(ValueError, match="generated part, in metres; got unit='mm'"):
        load_part("generated:hex_bolt:0", unit="mm")


@pytest.mark.slow
def test_wrong_numbers_are_refused() -> None:
    with pytest.raises(ValueError, match="index must be at least 0, got -1"):
        GeneratedName(family="hook", index=-1)
    with pytest.raises(ValueError, match=r"d_max_range must rise within 0\.02 to 0\.2 m, got \(0\.01, 0\.1\)"):
        GeneratedName(family="hook", index=0, d_max_range=(0.01, 0.1))
    with pytest.raises(ValueError, match="whole millimetres, got"):
        GeneratedName(family="hook", index=0, d_max_range=(0.0505, 0.1))
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        training_parts(0)
    with pytest.raises(ValueError, match=r"no handle of d_max 20 to 21 mm has walls of 1 mm; take a range"):
        load_part("generated:handle:0:20-21")
