"""How a file was read: where its unit came from, how many bodies it holds, what was repaired."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from binpick_env.parts import load_part
from binpick_env.parts.file_facts import FileFacts
from binpick_env.parts.mesh_file import read_mesh
from binpick_env.parts.simplification import simplified
from binpick_env.parts.surface import SurfaceProbe
from perception.geometry import make_transform
from tests.binpick_env.parts.part_meshes import ell

creation = trimesh.creation


def facts_of(path: Path, **options: str) -> FileFacts:
    facts: FileFacts = read_mesh(path, **options).metadata["facts"]  # type: ignore[arg-type]
    return facts


def test_a_clean_file_has_one_body_and_no_repairs(tmp_path: Path) -> None:
    ell().export(tmp_path / "ell.stl")
    part = load_part(tmp_path / "ell.stl", symmetry="none")
    assert part.file is not None
    assert part.file.origin == pytest.approx(ell().center_mass.tolist(), abs=1e-7)
    assert replace(part.file, origin=(0.0, 0.0, 0.0)) == FileFacts(unit="m", unit_origin="guessed")
    assert part.unit == "m"
    assert load_part("tee").file is None


def test_a_unit_is_given_named_or_guessed(tmp_path: Path) -> None:
    creation.box((60, 40, 30)).export(tmp_path / "box.stl")
    assert facts_of(tmp_path / "box.stl") == FileFacts(unit="mm", unit_origin="guessed")
    assert facts_of(tmp_path / "box.stl", unit="mm").unit_origin == "given"
    creation.box((60, 40, 30)).export(tmp_path / "box.3mf")
    assert facts_of(tmp_path / "box.3mf").unit_origin == "named"


def test_united_bodies_are_counted(tmp_path: Path) -> None:
    pin, head = creation.cylinder(radius=0.006, height=0.06), creation.cylinder(radius=0.015, height=0.012)
    trimesh.util.concatenate([pin, head]).export(tmp_path / "bolt.stl")
    assert facts_of(tmp_path / "bolt.stl") == FileFacts(unit="m", unit_origin="guessed", bodies=2)


def test_a_closed_hole_is_a_repair_with_the_area_that_it_added(tmp_path: Path) -> None:
    box = creation.box((0.06, 0.04, 0.03))
    box.update_faces(~np.isclose(box.triangles[:, :, 2], 0.015).all(axis=1))  # 24 of 108 cm^2
    box.export(tmp_path / "tub.stl")
    (repair,) = facts_of(tmp_path / "tub.stl").repairs
    assert repair == "4 open edges closed, which changed the surface's area by +29 %"


def test_edges_of_more_than_two_faces_are_a_repair(tmp_path: Path) -> None:
    near, far = (
        creation.box((0.02, 0.02, 0.01), make_transform(translation=np.full(3, k) * (1, 1, 0))) for k in (0, 0.02)
    )
    plate = creation.box((0.03, 0.03, 0.004), make_transform(translation=(0.01, 0.01, 0)))  # without it they are apart
    trimesh.util.concatenate([near, far, plate]).export(tmp_path / "edge.stl")
    facts = facts_of(tmp_path / "edge.stl")
    assert facts.repairs == ("1 edges of more than two faces separated, which changed the surface's area by +0 %",)
    assert facts.bodies == 3


def test_a_simplified_mesh_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("binpick_env.parts.mesh_file.MAX_FACES", 200)
    box = creation.box((0.06, 0.04, 0.03)).subdivide().subdivide().subdivide()
    box.export(tmp_path / "fine.ply")
    (repair,) = facts_of(tmp_path / "fine.ply").repairs
    assert repair.startswith("simplified from 768 to ")


def test_the_search_tree_of_a_mesh_of_many_faces_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    ball = creation.icosphere(subdivisions=4, radius=0.03)
    counts: list[int] = []

    class CountedProbe(SurfaceProbe):
        def __init__(self, mesh: trimesh.Trimesh, *, samples: int = 2000) -> None:
            counts.append(len(mesh.faces))
            super().__init__(mesh, samples=samples)

    monkeypatch.setattr("binpick_env.parts.simplification.SurfaceProbe", CountedProbe)
    simplified(ball, 0.0006)
    assert counts.count(len(ball.faces)) == 1
