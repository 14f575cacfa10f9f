"""One planning scene, solver and planner for each file of tests."""

import pytest

from policies.motion.ik import IkSolver
from policies.motion.planner import MotionPlanner
from policies.motion.planning_scene import PlanningScene
from tests.policies.motion.arm_motions import posture


@pytest.fixture(scope="module")
def scene():
    return PlanningScene()


@pytest.fixture(scope="module")
def ik(scene):
    return IkSolver(scene)


@pytest.fixture(scope="module")
def planner(scene, ik):
    return MotionPlanner(scene, ik)


@pytest.fixture(scope="module")
def q_grasp(ik):
    return posture(ik, (0.48, 0.05, 0.06))


@pytest.fixture(scope="module")
def q_tray(ik):
    return posture(ik, (0.42, -0.42, 0.15))
