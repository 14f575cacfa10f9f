"""Advice from findings made by hand: each piece has its own cause, and none comes without one."""

from dataclasses import replace
from typing import Any

import pytest

from binpick_env.option_words import option_words
from binpick_env.options import CellOptions
from binpick_env.parts.symmetry import NearSymmetry
from policies.assessment.advice import LOW_AP, MIN_POINTS, advise
from policies.assessment.findings import Findings
from policies.assessment.picking import Losses
from tests.policies.assessment.findings_of import FINE, changed

NEAR = NearSymmetry(angle_deg=180.0, axis=(0.0, 0.0, 1.0), deviation=0.0006, tolerance=0.0004)
LOW = changed("perception", ap=0.5).perception
CASES: list[tuple[str, Findings, str, str]] = [
    ("unit", changed("part", other_units={"cm": 0.22}), "--unit cm", "mm was guessed"),
    ("mesh", changed("part", repairs=("4 open edges closed",)), "closed solid", "4 open edges closed"),
    (
        "symmetry",
        changed("part", near_symmetry=NEAR),
        "--symmetry-tolerance 0.0007",
        "by 180° changes the surface by 0.60",
    ),
    ("weight", changed("part", mass=4.2), "an arm that carries more", "4.2 kg at 2700 kg/m^3, and a UR5e with this"),
    ("bin", changed("bin", largest_d_max=0.05), "shorter side is 416 mm or more", "holds a pile of parts up to 50 mm"),
    ("bin", changed("bin", capacity=10), "2.0 times the volume", "holds 10 of these parts, and 20 were to lie in it"),
    ("camera", changed("sight", whole_bin=False), "--camera-distance 0.85", "does not see the whole bin"),
    ("camera", changed("sight", points=0.0, distance=0.33), "--camera-distance 0.50", "shows no edge of the part"),
    ("camera", changed("sight", points=450.0, distance=1.2, depth=1.17), "--camera-distance 1.08", "450 boundary"),
    ("camera", changed("sight", points=250.0), "--width 2560 --height 1920", "250 boundary points"),
    ("jaw", changed("grip", grasps=0, least_width=0.09, reason="too wide"), "opens 97 mm or more", "too wide"),
    ("jaw", changed("grip", grasps=0, whole_stroke_grasps=90, reason="no"), "--jaw 0.085 takes the part", "no"),
    ("jaw", changed("grip", grasps=0, least_width=float("inf"), reason="no"), "suction cup", "no"),
    ("jaw", changed("grip", graspable_share=0.3), "reach under the part", "70 % of drops"),
    ("train", changed("perception", ap=0.5), "binpick train-segmentation --part clip.stl --unit mm", "AP of general"),
    ("train", changed("perception", ap=0.5, training="own"), "Train longer", "(own) is 50 %"),
]


@pytest.mark.parametrize(("kind", "findings", "text", "because"), CASES)
def test_each_cause_brings_one_piece_of_advice(kind: str, findings: Findings, text: str, because: str) -> None:
    (piece,) = advise(findings)
    assert piece.kind == kind
    assert text in piece.text
    assert because in piece.because


def lost(ends: str = "empty", dropped: int = 1, left: dict[str, int] | None = None, **shares: float) -> Findings:
    none: dict[str, Any] = {"segmentation": 0.0, "pose": 0.0, "picking": 0.0}
    shared = Losses(**{"delivered": 1.0 - sum(shares.values()), **none, **shares})
    return changed("picking", losses=shared, failures={"dropped": dropped}, ends={ends: 3}, left=left or {})


def test_losses_in_spite_of_true_poses_are_for_lack_of_room_or_of_hold() -> None:
    (room,) = advise(lost("abstained", 12, left={"no_clear_approach": 15, "ik_infeasible": 7}, picking=0.3))
    assert (room.kind, "22 of 75 parts were left" in room.because) == ("bin", True)
    # Bins that failed attempts ended leave parts behind, too, whatever their last frame says of them.
    (hold,) = advise(lost("2F", 6, left={"no_clear_approach": 45}, picking=0.3))
    assert (hold.kind, "6 of 75 attempts failed (6 dropped); the part weighs 60 g" in hold.because) == ("jaw", True)
    assert advise(lost("2F", 6, picking=0.05)) == ()


def test_lost_poses_ask_for_more_pixels() -> None:
    (piece,) = advise(lost(pose=0.2))
    assert (piece.kind, "true poses deliver 20 % more" in piece.because) == ("camera", True)
    larger = "Take a larger image: --width 1920 --height 1440; or use a smaller bin: from nearer than 0.85 m"
    assert piece.text.startswith(larger)
    near = replace(lost(pose=0.2), part=changed("part", near_symmetry=NEAR).part)
    assert [piece.kind for piece in advise(near)] == ["symmetry"]  # which explains the loss


def test_nothing_is_advised_where_all_is_well_or_nothing_was_run() -> None:
    assert advise(FINE) == ()
    assert advise(replace(FINE, perception=None, picking=None)) == ()


def test_a_value_at_its_limit_brings_no_advice() -> None:
    assert advise(changed("perception", ap=LOW_AP)) == ()
    assert advise(changed("sight", points=MIN_POINTS)) == ()
    assert advise(changed("perception", ap=float("nan"))) == ()  # no part to find


def test_the_camera_is_moved_before_a_network_is_trained() -> None:
    findings = replace(changed("perception", ap=0.5), sight=changed("sight", points=400.0).sight)
    assert [piece.kind for piece in advise(findings)] == ["camera"]


def test_the_nearer_camera_sees_as_many_points_as_are_needed() -> None:
    sight = changed("sight", points=450.0, distance=1.2, depth=1.17).sight
    nearer = sight.depth - (sight.distance - 1.08)
    assert sight.points * sight.depth / nearer >= MIN_POINTS
    assert sight.points * sight.depth / (nearer + 0.01) < MIN_POINTS


def test_advice_is_in_the_order_in_which_to_follow_it() -> None:
    part = changed("part", repairs=("holes closed",), other_units={"cm": 0.2}, near_symmetry=NEAR).part
    findings = replace(
        FINE,
        part=part,
        bin=changed("bin", capacity=3).bin,
        grip=changed("grip", graspable_share=0.0).grip,
        perception=changed("perception", ap=0.1).perception,
    )
    assert [piece.kind for piece in advise(findings)] == ["unit", "mesh", "symmetry", "bin", "jaw", "train"]


def test_training_scenes_have_the_cells_options() -> None:
    options = CellOptions(part="a clip.stl", bin=(0.3, 0.2, 0.1), jaw=0.05, hand_eye_mm=2.0, camera_distance=1.0)
    assert option_words(options) == ["--part", "a clip.stl", "--bin", "0.3", "0.2", "0.1", "--camera-distance", "1.0"]
    (piece,) = advise(replace(changed("bin", dropped=(7, 7)), perception=LOW, options=options))
    scenes = "--bin 0.3 0.2 0.1 --camera-distance 1.0 --min-parts 7 --max-parts 7 --count 300"
    assert f"generate-scenes --part 'a clip.stl' {scenes}" in piece.text
    assert piece.text.endswith("train-segmentation --part 'a clip.stl' --minutes 30")


def test_a_training_that_is_longer_than_the_last_one_has_a_folder_of_its_own() -> None:
    (piece,) = advise(changed("perception", ap=0.5, training="own"))
    assert piece.text.endswith("--minutes 30 --seed 1")


def test_failed_picks_of_a_part_that_is_too_heavy_are_not_put_down_to_bin_or_jaw() -> None:
    losses = Losses(delivered=0.0, segmentation=0.0, pose=0.0, picking=1.0)
    failing = changed("picking", losses=losses, failures={"not_settled": 6}, attempts=6, ends={"2F": 3})
    assert [piece.kind for piece in advise(failing)] == ["jaw"]
    heavy = replace(failing, part=replace(failing.part, mass=9.0))
    assert [piece.kind for piece in advise(heavy)] == ["weight"]
    light = replace(failing, part=replace(failing.part, mass=4.0))
    assert [piece.kind for piece in advise(light)] == ["jaw"]
