"""Which grasps a UR5e reaches, whose base and whose bin stand somewhere in the user's world."""

from copy import copy

import numpy as np

from binpick_env.cell.robot import HOME
from binpick_env.config import BinConfig, CellConfig, RobotConfig, TrayConfig
from perception.frame import Workspace
from perception.geometry import Floats, invert_transform, make_transform, rotation_angle
from policies.motion import IkSolver, PlannerSettings, PlanningScene

TILT = np.radians(3)  # largest angle between the z axes of bin and base; the planner's boxes are upright
_WALL = 0.02  # thickness of the bin's walls and floor; the table is taken to be below it [m]
_ASIDE = (0.0, 10.0)  # position of the simulated cell's tray, which a user's cell does not have [m]
_LOWEST = 0.01  # least height of the base above the table [m]
_SAME_PLACE = 1e-4  # largest difference of the positions and of the sides of bins that are taken to be one [m]
_SAME_TURN = np.radians(0.01)  # largest angle between them


class Reach:
    """Inverse kinematics of a UR5e with a 2F-85 over a bin, without a tray: table, bin and the arm itself block it.

    Attributes:
        T_world_base: (4, 4) pose of the robot's base.
        workspace: The bin.
    """

    def __init__(self, T_world_base: Floats, workspace: Workspace, jaw: float | None = None) -> None:
        """Compile the planner's models, which takes about a second.

        Args:
            T_world_base: (4, 4) pose of the robot's base, ROS's ``base_link``: z up, x to the front.
            workspace: The bin, in the same world.
            jaw: Largest opening of the jaw [m]; the gripper's whole stroke if None.

        Raises:
            ValueError: The bin is tilted against the base, or stands higher than it.
        """
        self.T_world_base, self.workspace, self._jaw = T_world_base, workspace, jaw
        self._prepare(PlanningScene(self._cell()))

    def _cell(self) -> CellConfig:
        """Return the planner's cell, in which the base stands at the origin, as high over the table as it does."""
        T_world_base, workspace = self.T_world_base, self.workspace
        T_base_bin = invert_transform(T_world_base) @ workspace.T_world_bin
        tilt = float(np.arccos(np.clip(T_base_bin[2, 2], -1, 1)))
        if tilt > TILT:
            raise ValueError(
                "the z axes of the robot's base and of the bin must agree to "
                f"{np.degrees(TILT):.0f} degrees, got {np.degrees(tilt):.1f}: check --robot-base, --bin-pose and "
                "--camera-pose, which must be in one world"
            )
        height = _WALL - float(T_base_bin[2, 3])  # of the base above the table
        if height < _LOWEST:
            raise ValueError(
                f"the bin's inner floor must be lower than the robot's base, got one that is "
                f"{1000 * T_base_bin[2, 3]:.0f} mm higher: check --robot-base and --bin-pose"
            )
        x, y, z = workspace.inner_size.tolist()
        place, yaw = T_base_bin[:2, 3].tolist(), float(np.arctan2(T_base_bin[1, 0], T_base_bin[0, 0]))
        return CellConfig(
            robot=RobotConfig(pedestal_height=height, jaw=self._jaw),
            bin=BinConfig(inner_size=(x, y, z), wall=_WALL, position=(place[0], place[1]), yaw=yaw),
            tray=TrayConfig(position=_ASIDE),
        )

    def _prepare(self, scene: PlanningScene) -> None:
        self._scene = scene
        self._ik = IkSolver(scene)
        height = scene.config.robot.pedestal_height
        self._T_cell_world = make_transform(translation=(0.0, 0.0, height)) @ invert_transform(self.T_world_base)
        self._clearance = PlannerSettings().line_clearance

    def at(self, workspace: Workspace) -> "Reach":
        """Return the reach over a bin, such as the one measured in a frame.

        It is this one where the bins agree to 0.1 mm and 0.01 degrees. Otherwise it is that which ``Reach`` makes of
        the bin, but the models of the robot are kept, so that it takes some hundredths of a second.

        Args:
            workspace: The bin, in the same world.

        Raises:
            ValueError: The bin is tilted against the base, or stands higher than it.
        """
        T_own, T_other = self.workspace.T_world_bin, workspace.T_world_bin
        lengths = np.concatenate([T_other[:3, 3] - T_own[:3, 3], workspace.inner_size - self.workspace.inner_size])
        turn = rotation_angle(T_own[:3, :3].T @ T_other[:3, :3])
        if np.abs(lengths).max() <= _SAME_PLACE and turn <= _SAME_TURN:
            return self
        other = copy(self)
        other.workspace = workspace
        other._prepare(self._scene.around(other._cell()))
        return other

    def reaches(self, T_world_tcp: Floats, opening: float) -> bool:
        """Return whether the arm reaches a pose of its tcp with the jaw open, clear of table, bin and itself.

        Args:
            T_world_tcp: (4, 4) pose at which the pads close on the part.
            opening: Distance between the pads during the approach [m].
        """
        found = self._ik.solve_grasp(self._T_cell_world @ T_world_tcp, HOME, opening=opening)
        return found.ok and not self._scene.contacts(found.q, opening=opening, clearance=self._clearance)
