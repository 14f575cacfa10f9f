"""Differential inverse kinematics: one descent from one seed, by mink's quadratic programs.

The model has six joints and a rigid jaw; an iteration takes 0.1 ms, and several times as much with collision avoidance.
"""

import mink
import mujoco
import numpy as np

from binpick_env.cell.robot import ARM_JOINTS, TCP_SITE
from perception.geometry import Floats
from policies.motion.ik_settings import IkSettings
from policies.motion.planning_scene import DOF

_ELBOW = 2  # index of the elbow's joint
_AVOIDING_ITERATIONS = 3  # iterations of a descent with collision avoidance, as a multiple of the usual number
_STALLED = 1e-5  # a smaller step of every joint is a local minimum [rad]


class DifferentialIk:
    """Descends from a posture towards a pose. Its configuration is scratch: no call depends on an earlier one."""

    def __init__(self, model: mujoco.MjModel, limits: Floats, settings: IkSettings) -> None:
        """Prepare mink's tasks and limits.

        Args:
            model: The cell with the arm's six joints.
            limits: (6, 2) lower and upper joint limits [rad].
            settings: Tolerances and steps.
        """
        self._settings, self._limits = settings, limits
        self._configuration = mink.Configuration(model)
        self._frame = mink.FrameTask(
            TCP_SITE, "site", position_cost=1.0, orientation_cost=settings.rotation_cost, lm_damping=1e-3
        )
        self._posture = mink.PostureTask(model, cost=settings.posture_cost)
        self._joint_limits: list[mink.Limit] = [HingeLimit(model)]
        self._all_limits: list[mink.Limit] = [
            *self._joint_limits,
            _collision_limit(model, settings.avoidance_distance),
        ]

    def descend(self, target: mink.SE3, seed: Floats, *, avoid_collisions: bool = False) -> tuple[Floats, int]:
        """Run one descent.

        Args:
            target: Pose of the tcp in the world.
            seed: (6,) posture to start from, clipped to the joint limits [rad].
            avoid_collisions: Whether forearm, wrist and gripper keep their distance from the cell.

        Returns:
            The (6,) posture in which the descent ended [rad], at the target or not, and the number of iterations.
        """
        configuration, settings = self._configuration, self._settings
        limits = self._all_limits if avoid_collisions else self._joint_limits
        max_step = settings.avoidance_max_step if avoid_collisions else settings.max_step
        max_iterations = settings.max_iterations * (_AVOIDING_ITERATIONS if avoid_collisions else 1)
        configuration.update(np.clip(seed, self._limits[:, 0], self._limits[:, 1]))
        self._frame.set_target(target)
        self._posture.set_target(configuration.q)
        for iteration in range(max_iterations):
            error = self._frame.compute_error(configuration)
            if self.within_tolerances(float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))):
                return configuration.q.copy(), iteration
            try:
                step = mink.solve_ik(configuration, [self._frame, self._posture], 1.0, "daqp", limits=limits)
            except mink.NoSolutionFound:  # the limits contradict each other here: this descent ends
                return configuration.q.copy(), iteration + 1
            largest = float(np.max(np.abs(step)))
            if largest < _STALLED:
                return configuration.q.copy(), iteration + 1
            configuration.integrate_inplace(step * min(1.0, max_step / largest), 1.0)
        return configuration.q.copy(), max_iterations

    def within_tolerances(self, position_error: float, rotation_error: float) -> bool:
        """Return whether a distance [m] and an angle [rad] from the target are small enough."""
        # 1e-9: the residual is measured twice, by mink's logarithm and by the angle, which differ in the last digits.
        within = position_error <= self._settings.position_tolerance + 1e-9
        return within and rotation_error <= self._settings.rotation_tolerance + 1e-9

    def min_singular_value(self, q: Floats) -> float:
        """Return the smallest singular value of the tcp's Jacobian at a (6,) posture [rad]; 0 at a singularity."""
        self._configuration.update(q)
        jacobian = self._configuration.get_frame_jacobian(TCP_SITE, "site")
        return float(np.linalg.svd(jacobian, compute_uv=False)[-1])


class HingeLimit(mink.ConfigurationLimit):
    """mink's limit of the joints' positions, for hinges that all have limits: the same bits, faster.

    Its rows do not depend on the posture, and the difference between two postures is a plain subtraction.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        super().__init__(model)
        self._rows = np.vstack([np.eye(DOF), -np.eye(DOF)])

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> mink.Constraint:  # noqa: ARG002
        """Return the constraint that keeps a step within ``gain`` of the distance to each limit."""
        q = configuration.q
        return mink.Constraint(G=self._rows, h=self.gain * np.concatenate([self.upper - q, q - self.lower]))


def _collision_limit(model: mujoco.MjModel, distance: float) -> mink.CollisionAvoidanceLimit:
    """Return the limit that keeps forearm, wrist and gripper ``distance`` [m] from whatever stands in the cell."""
    still = model.body_weldid[model.geom_bodyid] == 0
    moving = model.body_rootid[model.joint(ARM_JOINTS[_ELBOW]).bodyid[0]] == model.body_rootid[model.geom_bodyid]
    beyond_elbow = model.geom_bodyid >= model.joint(ARM_JOINTS[_ELBOW]).bodyid[0]
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    arm = np.flatnonzero(moving & beyond_elbow & ~still & collides).tolist()
    cell = np.flatnonzero(still & collides).tolist()
    return mink.CollisionAvoidanceLimit(
        model,
        [(arm, cell)],
        minimum_distance_from_collisions=distance,
        collision_detection_distance=0.12,  # further than any tip gets in one such step
        bound_relaxation=-3e-4,  # pushes back: at 0, pads over a flat floor creep into it from corner to corner
    )
