"""What is said of a part before anything is measured."""

from pathlib import Path

import pytest
import trimesh

from binpick_env.parts import load_part
from policies.assessment.part import part_facts


def test_the_size_of_a_round_part_that_is_drawn_tilted_is_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    turn = trimesh.transformations.rotation_matrix(0.5, (1.0, 0.3, 0.2))
    path = tmp_path / "part.stl"
    trimesh.creation.cylinder(radius=33.0, height=80.0, sections=64).apply_transform(turn).export(path)
    assert part_facts(load_part(path, unit="mm")).size == pytest.approx((0.080, 0.066, 0.066), rel=0.002)
