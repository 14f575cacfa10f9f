"""Parts that each need exactly one piece of advice, measured without any scene."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import trimesh

from binpick_env.options import CellOptions
from policies.assessment import grip
from policies.assessment.advice import Advice, advise
from policies.assessment.config import AssessmentConfig
from policies.assessment.findings import Findings
from policies.assessment.run import describe
from policies.grasping.grasps import GraspSettings

pytestmark = pytest.mark.slow
box = trimesh.creation.box
SIDES = (80, 40, 25)  # of a part about which nothing is to be done [mm]
Assessed = Callable[..., Findings]


@pytest.fixture(scope="module", autouse=True)
def _few_grasps_are_sampled() -> Iterator[None]:
    few = GraspSettings(samples=250, max_grasps=600, max_checked=5000)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grip, "GraspSettings", lambda: few)
        yield


@pytest.fixture(scope="module")
def assessed(tmp_path_factory: pytest.TempPathFactory) -> Assessed:
    """Return a function that describes a mesh [mm] in a cell, as a part file of a known unit unless said otherwise."""

    def describe_mesh(mesh: trimesh.Trimesh, **options: Any) -> Findings:
        path = tmp_path_factory.mktemp("part") / "part.stl"
        mesh.export(path)
        config = AssessmentConfig(options=CellOptions(**{"part": str(path), "unit": "mm", **options}), num_parts=(2, 2))
        return describe(config, config.options.read_part())

    return describe_mesh


def only(findings: Findings) -> Advice:
    (piece,) = advise(findings)
    return piece


def test_a_block_needs_nothing(assessed: Assessed) -> None:
    findings = assessed(box(SIDES))
    assert advise(findings) == ()
    assert findings.part.size == pytest.approx((0.08, 0.04, 0.025))
    assert findings.part.mass == pytest.approx(0.216)
    assert findings.grip.graspable_share == pytest.approx(1.0)
    assert findings.rests[0].height == pytest.approx(0.025)


def test_a_small_part_in_a_guessed_unit_needs_the_unit(assessed: Assessed) -> None:
    near: dict[str, Any] = {"bin": (0.16, 0.12, 0.05), "camera_distance": 0.45, "width": 1600, "height": 1200}
    piece = only(assessed(box((19, 13, 9)), unit=None, **near))
    assert piece.kind == "unit"
    assert "--unit mm if the part is 25 mm long; else --unit cm" in piece.text


def test_an_open_mesh_needs_a_check(assessed: Assessed) -> None:
    mesh = box(SIDES)
    mesh.update_faces(~np.isclose(mesh.triangles[:, :, 2], 12.5).all(axis=1))
    piece = only(assessed(mesh))
    assert piece.kind == "mesh"
    assert "4 open edges closed" in piece.because


def test_a_nearly_square_bar_needs_a_tolerance(assessed: Assessed) -> None:
    piece = only(assessed(box((80, 40.6, 39.4))))
    assert piece.kind == "symmetry"
    assert "by 90° changes the surface by 0.60 mm" in piece.because
    assert "--symmetry-tolerance 0.0007" in piece.text


def test_a_part_longer_than_the_bin_needs_another_bin(assessed: Assessed) -> None:
    piece = only(assessed(box(SIDES), bin=(0.07, 0.06, 0.1)))
    assert piece.kind == "bin"
    assert piece.text == "Use a bin whose shorter side is 121 mm or more"


def test_a_bin_for_one_part_needs_another_bin(assessed: Assessed) -> None:
    piece = only(assessed(box(SIDES), bin=(0.125, 0.122, 0.02)))
    assert piece.kind == "bin"
    assert "holds 1 of these parts, and 2 were to lie in it" in piece.because


def test_a_part_of_few_pixels_needs_a_nearer_camera(assessed: Assessed) -> None:
    findings = assessed(box(SIDES), width=640, height=480, camera_distance=1.1)
    piece = only(findings)
    assert piece.kind == "camera"
    nearer = float(piece.text.split()[-1])
    assert nearer < 1.1
    assert only_kinds(assessed(box(SIDES), width=800, height=600, camera_distance=nearer)) == []


def only_kinds(findings: Findings) -> list[str]:
    return [piece.kind for piece in advise(findings)]


def test_a_bin_out_of_view_needs_a_camera_farther_away(assessed: Assessed) -> None:
    piece = only(assessed(box(SIDES), camera_distance=0.6))
    assert piece.kind == "camera"
    assert piece.text == "Move the camera away: --camera-distance 0.85"
    assert only_kinds(assessed(box(SIDES), camera_distance=0.85)) == []


def test_a_part_wider_than_the_jaw_opens_needs_another_jaw(assessed: Assessed) -> None:
    findings = assessed(box((120, 105, 90)))
    piece = only(findings)
    assert piece.kind == "jaw"
    assert "opens 97 mm or more" in piece.text
    assert findings.grip.reason is not None
    narrow = only(assessed(box(SIDES), jaw=0.03))
    assert narrow.kind == "jaw"
    assert "--jaw 0.085 takes the part" in narrow.text


def test_a_wide_plate_needs_another_jaw_since_it_lies_flat(assessed: Assessed) -> None:
    findings = assessed(box((110, 100, 10)))
    piece = only(findings)
    assert findings.grip.grasps > 0
    assert piece.kind == "jaw"
    assert "of drops end in a pose from which no grasp picks the part off the floor" in piece.because
