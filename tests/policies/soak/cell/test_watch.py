"""The rules for the cell's steps: depth in walls, energy, driven parts, observations."""

from collections.abc import Iterator

import numpy as np
import pytest
from gymnasium import spaces

from binpick_env.cell.robot import HOME
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CellConfig
from binpick_env.parts import load_part
from perception.geometry import make_transform, random_rotation
from policies.soak.cell.depth import DepthGauge
from policies.soak.cell.energy import DrivenParts, EnergyMeter
from policies.soak.cell.watch import REST, CellWatch, Limits, lightness

FLOOR = 0.02  # height of the bin's inner floor in the world [m]
AT = (0.5, 0.0)  # centre of the bin in the world's x and y [m]


@pytest.fixture(scope="module")
def shared() -> Simulation:
    return Simulation(CellConfig(), load_part("bracket"), 3)


@pytest.fixture
def simulation(shared: Simulation) -> Iterator[Simulation]:
    shared.reset()
    yield shared
    shared.reset()


def lowest(simulation: Simulation) -> float:
    """Return the lowest corner of the part in its own frame [m]."""
    return min(float(np.asarray(piece.vertices)[:, 2].min()) for piece in simulation.part.pieces)


def put(simulation: Simulation, i: int, above: float) -> None:
    """Put part i upright over the middle of the bin, with its lowest corner so far above the floor [m]."""
    simulation.place(i, make_transform(translation=(*AT, FLOOR + above - lowest(simulation))))
    simulation.refresh()


def test_the_depth_in_the_floor_is_that_of_the_lowest_corner(simulation: Simulation) -> None:
    gauge = DepthGauge(simulation)
    put(simulation, 1, -0.003)
    depths, boxes = gauge.depths()
    assert depths == pytest.approx([0.0, 0.003, 0.0], abs=1e-9)
    assert gauge.names[boxes[1]] == "bin/floor"
    put(simulation, 1, 0.001)
    assert gauge.depths()[0] == pytest.approx([0.0, 0.0, 0.0])


def test_the_depth_in_a_wall_is_that_of_the_outermost_corner(simulation: Simulation) -> None:
    gauge = DepthGauge(simulation)
    workspace = simulation.config.bin.workspace()
    corners = np.concatenate([np.asarray(piece.vertices) for piece in simulation.part.pieces])
    x = workspace.inner_size[0] / 2 - corners[:, 0].max() + 0.004
    simulation.place(0, workspace.T_world_bin @ make_transform(translation=(x, 0.0, 0.03 - lowest(simulation))))
    depths, boxes = gauge.depths()
    assert depths[0] == pytest.approx(0.004, abs=1e-9)
    assert gauge.names[boxes[0]] == "bin/wall_x+"


def test_the_energy_of_a_turning_part_is_that_of_its_mass_points(simulation: Simulation) -> None:
    rng = np.random.default_rng(0)
    simulation.place(0, make_transform(random_rotation(rng), (*AT, 0.3)))
    velocity, spin = rng.normal(size=3), rng.normal(size=3)
    simulation.data.qvel[simulation._part_dof[0]] = [*velocity, *spin]
    energy = EnergyMeter(simulation).energies() - EnergyMeter(simulation).energies()[1]  # a part that is parked
    mass, inertia, centre = simulation.part.mass, simulation.part.inertia, simulation.part.model.centre
    R_world_part = simulation.part_poses()[0, :3, :3]
    of_centre = velocity + R_world_part @ np.cross(spin, centre)
    kinetic = 0.5 * mass * of_centre @ of_centre + 0.5 * spin @ inertia @ spin
    above = np.diff(simulation.part_centres()[[1, 0], 2])[0]
    assert energy[0] == pytest.approx(kinetic + 9.81 * mass * above, rel=1e-6)


def test_parts_are_driven_through_other_parts_but_not_through_the_floor(simulation: Simulation) -> None:
    driven = DrivenParts(simulation)
    geoms = [np.flatnonzero(simulation.part_of_geom == i)[0] for i in range(3)]
    robot = int(np.flatnonzero(simulation.is_robot_geom)[0])
    floor = simulation.model.geom("bin/floor").id
    driven._pairs = [np.array([(robot, geoms[0]), (geoms[1], geoms[0]), (geoms[0], floor), (geoms[2], floor)])]
    assert driven.mask().tolist() == [True, True, False]
    driven.clear()
    driven.collect()
    assert not driven.mask().any()


def test_a_part_in_the_floor_is_a_problem_once_an_episode(simulation: Simulation) -> None:
    watch = CellWatch(simulation)
    put(simulation, 0, -0.004)
    for _ in range(2):
        watch.begin("first pile")
    assert [problem.split(": ")[1] for problem in watch.problems] == [
        "a part that the robot leaves alone is 4.0 mm inside bin/floor, at rest at 0.00 m/s"
    ] * 2
    assert watch.deepest == pytest.approx(0.004)


def test_a_part_that_sinks_in_while_it_lands_is_none(simulation: Simulation) -> None:
    watch = CellWatch(simulation)
    put(simulation, 0, 0.1)
    watch.begin("a drop")
    with watch.watching():
        for _ in range(12):
            simulation.step(HOME, 0.0)
    assert watch.steps == 12
    assert watch.problems == []
    assert 0.0 < watch.deepest < 0.01
    assert watch.gain < 0.01  # a fall is no gain, a rebound nearly none
    assert "step" not in vars(simulation)  # nobody watches any more


def test_a_part_that_lands_within_a_step_was_faster_than_before_it(simulation: Simulation) -> None:
    watch = CellWatch(simulation)
    put(simulation, 0, -0.004)
    watch._speeds[0] = 0.3  # 0.6 m/s at most when it lands, which may be 4.1 mm deep
    watch._judge_depth("moving")
    assert watch.problems == []
    watch._speeds[0] = 0.2
    watch._judge_depth("moving")
    assert "4.0 mm inside bin/floor, moving at 0.40 m/s" in watch.problems[0]


def test_a_part_that_gains_energy_by_itself_is_a_problem(simulation: Simulation) -> None:
    watch = CellWatch(simulation, Limits(gain=0.001))
    put(simulation, 0, 0.1)
    watch.begin("a drop")
    simulation.model.opt.gravity[2] *= 3  # in place of whatever might drive it
    with watch.watching():
        for _ in range(4):
            simulation.step(HOME, 0.0)
    simulation.model.opt.gravity[2] /= 3
    (problem,) = watch.problems
    assert "a part that the robot does not touch gains" in problem


def test_a_part_that_the_robot_pushes_may_be_deep_but_not_in_the_middle_of_a_wall(simulation: Simulation) -> None:
    watch = CellWatch(simulation)
    watch.begin("a push")
    watch._since[:] = REST - 1
    put(simulation, 0, -0.004)
    watch._judge_depth("moving")
    assert watch.problems == []
    assert watch.pressed == pytest.approx(0.004)
    put(simulation, 0, -0.00995)
    watch._judge_depth("moving")
    (problem,) = watch.problems
    assert "a part is pushed to the middle of bin/floor" in problem


def test_a_push_that_lasts_is_a_problem(simulation: Simulation) -> None:
    watch = CellWatch(simulation)
    watch.begin("a push")
    put(simulation, 0, -0.004)
    for _ in range(2):  # the first one ends in time
        put(simulation, 0, -0.001)
        watch._judge_depth("moving")
        put(simulation, 0, -0.004)
        watch._since[:] = 0
        for _ in range(REST - 1):
            watch._judge_depth("moving")
        assert watch.problems == []
    watch._judge_depth("moving")
    (problem,) = watch.problems
    assert f"a part that the robot pushes is 4.0 mm inside bin/floor for {REST} steps" in problem
    watch.begin("another")
    watch._since[:] = 0
    watch._judge_depth("moving")
    assert len(watch.problems) == 2  # the pile at its start, and no push as yet


def test_a_light_part_may_be_pushed_deeper(simulation: Simulation) -> None:
    watch = CellWatch(simulation)
    watch._lightness = lightness(0.025)
    put(simulation, 0, -0.004)
    for _ in range(REST):
        watch._since[:] = 0
        watch._judge_depth("moving")
    assert watch.problems == []


def test_an_observation_outside_of_its_space_or_without_a_number_is_a_problem(simulation: Simulation) -> None:
    watch = CellWatch(simulation)
    space = spaces.Dict({"q": spaces.Box(-1, 1, (2,), np.float32)})
    watch.judge_observation({"q": np.zeros(2, np.float32)}, space)
    assert watch.problems == []
    watch.judge_observation({"q": np.array([0, np.nan], np.float32)}, space)
    watch.begin("another")
    watch.judge_observation({"q": np.array([0, 2], np.float32)}, space)
    assert [problem.split(": ")[1] for problem in watch.problems] == [
        "q of the observation is not finite",
        "the observation is outside its space",
        "the observation is outside its space",
    ]


@pytest.mark.parametrize(("mass", "factor"), [(0.3, 1.0), (0.05, 1.0), (0.04, 1.25), (0.025, 2.0), (0.004, 2.2)])
def test_light_parts_may_be_pushed_in_deeper_up_to_a_limit(mass: float, factor: float) -> None:
    assert lightness(mass) == pytest.approx(factor)
