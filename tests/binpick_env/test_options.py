"""The options of a cell: each arrives where it belongs, from `CellOptions` and from `gym.make`; nonsense is refused."""

import inspect
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import trimesh

import binpick_env  # noqa: F401  registers the id
from binpick_env.cell.delivery import Delivery, DeliveryJudge
from binpick_env.cell.kinematic_motion import KinematicMotion
from binpick_env.cell.robot import HOME
from binpick_env.config import (
    CONTROL_PERIOD,
    BinConfig,
    CalibrationConfig,
    CameraConfig,
    CellConfig,
    ContactConfig,
    RobotConfig,
)
from binpick_env.env import BinPickEnv
from binpick_env.options import CellOptions, resolve_cell
from binpick_env.parts import load_part
from policies.selection.env import GraspSelectionEnv
from tests.binpick_env.small_cell import REST, above_tray, act, assert_same, small_simulation

pytestmark = pytest.mark.slow

TINY: dict[str, Any] = {"num_parts": 1, "perception": "oracle", "threads": 1, "width": 64, "height": 48}


def friction_of_the_bin(env: BinPickEnv) -> float:
    return float(env.simulation.model.geom("bin/floor").friction[0])


def mass_of_a_part(env: BinPickEnv) -> float:
    return float(env.simulation.model.body("part_0").mass[0])


def inner_width_of_the_bin(env: BinPickEnv) -> float:
    """Return the distance between the inner faces of the bin's short walls in the compiled model [m]."""
    walls = [env.simulation.model.geom(f"bin/wall_x{sign}") for sign in "+-"]
    return float(walls[0].pos[0] - walls[1].pos[0] - walls[0].size[0] - walls[1].size[0])


def spread_of_the_camera(env: BinPickEnv) -> float:
    """Return the largest offset of the camera's reported position over some bins [mm]."""
    offsets = []
    for seed in range(6):
        env.reset(seed=seed)
        offsets.append(1000 * float(np.abs(env.camera.offset_world).max()))
    return max(offsets)


# option: value, what is read of the environment, expected (None: not the default's)
OPTIONS: dict[str, tuple[Any, Callable[[BinPickEnv], object], object]] = {
    "part": ("bracket", lambda env: env.part.source, "bracket"),
    "symmetry": ("none", lambda env: len(env.part.model.symmetry.rotations), 1),
    "density": (2000.0, lambda env: mass_of_a_part(env) / env.part.model.mesh.volume, pytest.approx(2000.0)),
    "bin": ((0.3, 0.24, 0.1), inner_width_of_the_bin, pytest.approx(0.3)),
    "jaw": (0.05, lambda env: round(env.simulation.gripper_open, 3), 0.43),
    "max_acceleration": (4.0, lambda env: env.config.robot.max_acceleration, 4.0),
    "max_jerk": (50.0, lambda env: env.config.robot.max_jerk, 50.0),
    "camera_distance": (1.1, lambda env: round(float(env.camera.T_world_cam[2, 3]), 6), 1.12),
    "width": (80, lambda env: env.camera.K[0, 2], 39.5),
    "height": (60, lambda env: env.camera.K[1, 2], 29.5),
    "sensor": ("none", lambda env: bool(np.array_equal(env.frame.depth, env.capture.depth_true)), True),
    "backend": ("rays", lambda env: env.camera.config.backend, "rays"),
    "hand_eye_mm": (5.0, lambda env: 2.0 < spread_of_the_camera(env) < 25.0, True),
    "friction": (0.2, friction_of_the_bin, pytest.approx(0.2)),
    "hand_eye_deg": (1.0, lambda env: 0.1 < np.degrees(np.linalg.norm(env.camera.rotation_cam)) < 6.0, True),
    "trust": ("bin", lambda env: env.config.calibration.trust, "bin"),
}
ELSEWHERE = {"unit", "symmetry_tolerance"}  # in tests of their own, since they need a file


@pytest.fixture(scope="module")
def standard() -> BinPickEnv:
    env = BinPickEnv(**TINY)
    env.reset(seed=0)
    return env


@pytest.mark.parametrize("name", OPTIONS)
def test_an_option_of_gym_make_arrives(standard: BinPickEnv, name: str) -> None:
    value, read, expected = OPTIONS[name]
    standard.reset(seed=0)
    assert read(standard) != expected
    env = gym.make("BinPick-v0", **TINY | {name: value})
    env.reset(seed=0)
    assert read(env.unwrapped) == expected  # type: ignore[arg-type]
    env.close()


STANDARD = CellConfig()
CELLS = {
    "bin": replace(STANDARD, bin=BinConfig(inner_size=(0.3, 0.24, 0.1))),
    "jaw": replace(STANDARD, robot=RobotConfig(jaw=0.05)),
    "max_acceleration": replace(STANDARD, robot=RobotConfig(max_acceleration=4.0)),
    "max_jerk": replace(STANDARD, robot=RobotConfig(max_jerk=50.0)),
    "friction": replace(STANDARD, contact=ContactConfig(friction=(0.2, 0.005, 0.0002))),
    "camera_distance": replace(STANDARD, camera=CameraConfig(distance=1.1)),
    "width": replace(STANDARD, camera=CameraConfig(width=80)),
    "height": replace(STANDARD, camera=CameraConfig(height=60)),
    "hand_eye_mm": replace(STANDARD, camera=CameraConfig(hand_eye=0.005)),
    "backend": replace(STANDARD, camera=CameraConfig(backend="rays")),
    "hand_eye_deg": replace(STANDARD, calibration=CalibrationConfig(rotation=float(np.deg2rad(1.0)))),
    "trust": replace(STANDARD, calibration=CalibrationConfig(trust="bin")),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_an_option_of_cell_options_arrives_in_the_config(name: str) -> None:
    cell = CellOptions(**{name: OPTIONS[name][0]}).cell()
    assert cell == CELLS.get(name, STANDARD)
    assert hash(cell) == hash(CELLS.get(name, STANDARD))


@pytest.mark.parametrize("kind", [BinPickEnv, GraspSelectionEnv])
def test_the_environments_take_every_option(kind: type) -> None:
    assert {field.name for field in fields(CellOptions)} <= set(inspect.signature(kind).parameters)


def test_every_option_is_tested() -> None:
    assert {field.name for field in fields(CellOptions)} == set(OPTIONS) | ELSEWHERE


def test_the_defaults_are_the_standard_cell() -> None:
    assert CellOptions().cell() == CellConfig() == resolve_cell(None, None)
    assert CellOptions().load_part() is load_part("tee")
    with pytest.raises(FrozenInstanceError):
        CellOptions().part = "bracket"  # type: ignore[misc]


def test_the_unit_of_a_file_arrives(tmp_path: Path, cache: Path) -> None:
    """A block drawn 0.9 inch long is 23 mm long."""
    path = tmp_path / "block.ply"
    trimesh.creation.box((0.9, 0.6, 0.4)).export(path)
    options = CellOptions(part=str(path), unit="inch", symmetry="none", density=1000.0)
    part = options.load_part()
    assert part.model.mesh.extents.max() == pytest.approx(0.9 * 0.0254, rel=1e-6)
    assert (part.unit, part.density, len(part.model.symmetry.rotations)) == ("inch", 1000.0, 1)
    env = gym.make("BinPick-v0", **TINY, part=str(path), unit="inch", symmetry="none")
    assert env.unwrapped.part.model.d_max == part.model.d_max  # type: ignore[attr-defined]
    env.close()


def test_the_symmetry_tolerance_of_a_file_arrives(tmp_path: Path, cache: Path) -> None:
    """A bar of 50 x 50.6 mm is square within 0.5 mm."""
    path = tmp_path / "bar.ply"
    trimesh.creation.box((0.05, 0.0506, 0.08)).export(path)
    for tolerance, order in ((0.0002, 4), (0.0005, 8)):
        options = CellOptions(part=str(path), symmetry_tolerance=tolerance)
        assert options.load_part().model.symmetry.order == order
        env = gym.make("BinPick-v0", **TINY, part=str(path), symmetry_tolerance=tolerance)
        assert env.unwrapped.part.model.symmetry.order == order  # type: ignore[attr-defined]
        env.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"unit": "feet"}, "unit must be one of m, mm, cm, inch, got 'feet'"),
        ({"symmetry": "some"}, "symmetry must be 'detect' or 'none', got 'some'"),
        ({"symmetry_tolerance": 0.0}, r"symmetry_tolerance must be over 0 and under 0.1 m, got 0.0"),
        ({"density": 0.0}, r"density must be 10 to 25000 kg/m\^3"),
        ({"bin": (0.3, 0.2)}, r"bin must be length, width and height inside \[m\], all positive, got \(0\.3, 0\.2\)"),
        ({"bin": 0.3}, r"bin must be length, width and height inside \[m\], all positive, got 0\.3"),
        ({"bin": ("long", 0.2, 0.1)}, r"bin must be length, width and height inside \[m\], all positive, got \('long'"),
        ({"width": 640.5}, r"width must be int, got 640\.5"),
        ({"friction": "low"}, r"friction must be float \| None, got 'low'"),
        ({"bin": (0.3, 0.0, 0.1)}, r"bin must be length, width and height inside \[m\], all positive, got \(0\.3"),
        ({"bin": (360, 260, 120)}, r"bin may be up to 0\.54 m long .*, got \(360, .*: type --bin 360x260x120 if mill"),
        ({"bin": (36, 26, 12)}, r": type --bin 360x260x120 if centimetres were meant \(in Python, bin= is in metres\)"),
        ({"bin": (0.036, 0.026, 0.012)}, r"bin must be at least 0\.05 m long .*, got \(0\.036, .* if centimetres were"),
        ({"bin": (0.00036, 0.00026, 0.00012)}, r"got \(0\.00036, .*\[m\]: type --bin 360x260x120 if metres were meant"),
        (
            {"bin": (0.02, 0.02, 0.0001)},
            r"bin must be at least 0\.05 m long inside, got \(0\.02, 0\.02, 0\.0001\) \[m\]$",
        ),
        ({"bin": (0.3, 0.8, 0.1)}, r"bin may be up to 0\.54 m long and 0\.78 m wide between robot and tray, got"),
        ({"max_acceleration": 0.0}, r"max_acceleration must be positive, got 0\.0"),
        ({"max_jerk": -1.0}, r"max_jerk must be positive, or None for no limit, got -1\.0"),
        ({"jaw": 0.0}, r"jaw must be over 0 and at most 0\.085 m, the 2F-85's stroke, got 0\.0"),
        ({"jaw": 0.14}, r"jaw must be over 0 and at most 0\.085 m, the 2F-85's stroke, got 0\.14"),
        ({"camera_distance": 0.1}, r"camera_distance must exceed 0\.2 m \(0\.2 m or the bin's height\), got 0\.1 m"),
        (
            {"camera_distance": 900.0},
            "camera_distance must be in metres, got 900 m, which seems to be millimetres: div",
        ),
        ({"bin": (0.3, 0.2, 0.5), "camera_distance": 0.4}, r"camera_distance must exceed 0\.5 m .*, got 0\.4 m"),
        ({"width": 8}, "the image must be at least 16 x 16, got 8 x 960"),
        ({"height": 8}, "the image must be at least 16 x 16, got 1280 x 8"),
        ({"backend": "gl"}, "backend must be one of rays, egl, raster, got 'gl'"),
        ({"sensor": "fine"}, "sensor must be one of none, good, harsh, stereo, tof, got 'fine'"),
        ({"hand_eye_mm": 16.0}, r"hand_eye_mm must be from 0 to 15 mm, got 16\.0"),
        ({"hand_eye_mm": -1.0}, r"hand_eye_mm must be from 0 to 15 mm, got -1\.0"),
        ({"hand_eye_deg": 4.0}, r"hand_eye_deg must be from 0 to 3 degrees, got 4\.0"),
        ({"trust": "floor"}, "trust must be one of camera, bin, got 'floor'"),
        ({"friction": -0.1}, r"friction must be from 0 to 2, got -0\.1"),
        ({"friction": 50.0}, r"friction must be from 0 to 2, got 50\.0"),
    ],
)
def test_nonsense_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CellOptions(**options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"config": CellConfig(), "jaw": 0.05}, "jaw cannot be given beside config, which contains it: set it in"),
        ({"config": CellConfig(), "bin": (0.3, 0.2, 0.1), "friction": 0.3}, "bin, friction cannot be given beside"),
        ({"config": CellConfig(), "max_jerk": 50.0}, "max_jerk cannot be given beside config"),
        ({"config": CellConfig(), "trust": "bin"}, "trust cannot be given beside config"),
        ({"config": CellConfig(), "width": 640}, "width cannot be given beside config"),
        ({"camera": CameraConfig(), "camera_distance": 1.0}, "camera_distance cannot be given beside camera, which"),
        ({"camera": CameraConfig(), "height": 480}, "height cannot be given beside camera"),
        ({"camera": CameraConfig(), "hand_eye_mm": 0.0}, "hand_eye_mm cannot be given beside camera"),
        ({"config": {}}, r"config must be a CellConfig, got \{\}: make one of its fields"),
        ({"camera": {"width": 64}}, r"camera must be a CameraConfig, got \{'width': 64\}: make one of its fields"),
        ({"part": load_part("tee"), "unit": "mm"}, "unit cannot be given beside a loaded part: give it to load_part"),
        ({"part": load_part("tee"), "symmetry": "none", "density": 900.0}, "symmetry, density cannot be given beside"),
    ],
)
def test_a_contradiction_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        BinPickEnv(perception="oracle", **arguments)


def test_a_camera_goes_with_options_that_it_does_not_contain() -> None:
    camera = CameraConfig(width=64, height=48)
    cell = resolve_cell(None, camera, jaw=0.05, friction=None)
    assert (cell.camera, cell.robot.jaw) == (camera, 0.05)


# --- a narrow jaw


def test_a_narrow_jaw_starts_as_open_as_it_gets_and_opens_no_further() -> None:
    simulation = small_simulation(config=CellOptions(jaw=0.05).cell())
    start = simulation.gripper_position
    assert simulation.gripper_open == simulation.gripper_target == pytest.approx(0.43, abs=1e-3)
    for _ in range(25):
        simulation.step(simulation.target, 0.0)
    assert simulation.gripper_target == simulation.gripper_open
    assert simulation.gripper_position == pytest.approx(start, abs=2e-3)
    simulation.step(simulation.target, 1.0)
    assert simulation.gripper_target > simulation.gripper_open  # it still closes


def test_kinematic_motion_opens_a_narrow_jaw_no_further() -> None:
    simulation = small_simulation(config=CellOptions(jaw=0.05).cell())
    motion = KinematicMotion(simulation)
    start = simulation.gripper_position
    motion.place(HOME, HOME, 0.0)
    assert simulation.gripper_target == simulation.gripper_open
    assert simulation.gripper_position == pytest.approx(start, abs=1e-2)  # its table is measured in shorter rests
    motion.place(HOME, HOME, 0.8)
    assert simulation.gripper_target == 0.8


@pytest.mark.parametrize(("command", "kinds"), [(0.75, [Delivery.DELIVERED]), (0.80, [Delivery.UNRELEASED])])
def test_a_narrow_jaw_releases_by_opening_as_wide_as_it_gets(command: float, kinds: list[Delivery]) -> None:
    """At 20 mm it is wide open at a command of 0.76, at which the full stroke would count as nearly closed."""
    simulation = small_simulation(config=CellOptions(jaw=0.02).cell())
    judge = DeliveryJudge(simulation, CONTROL_PERIOD)
    simulation.place(0, above_tray(simulation))
    events = []
    for _ in range(40):
        simulation.step(HOME, command)
        events += judge.update(command)
    assert [event.kind for event in events] == kinds


def test_an_env_with_every_option_is_repeatable() -> None:
    options: dict[str, Any] = TINY | {"jaw": 0.04, "friction": 0.3, "bin": (0.3, 0.24, 0.1), "hand_eye_mm": 2.0}
    first, second = BinPickEnv(**options), BinPickEnv(**options)
    assert_same(first.reset(seed=4)[0], second.reset(seed=4)[0])
    kept = first.snapshot()
    steps = act(first, 0.2, REST)
    first.restore(kept)
    assert_same(steps[-1][0], act(first, 0.2, REST)[-1][0])
