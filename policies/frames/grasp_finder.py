"""Grasps on the parts found in a frame: clear of everything else that was measured, and within reach of a robot."""

import logging
from dataclasses import dataclass, replace

import numpy as np

from binpick_env.candidates import PoseCandidate
from perception.frame import Frame, Workspace
from perception.geometry import Floats, invert_transform, transform_points
from perception.part import PartModel
from perception.pose.pose_estimate import PoseEstimate
from policies.frames.reach import Reach
from policies.grasping import (
    GraspCandidate,
    ObservedScene,
    RankSettings,
    gripper_model,
    rank_grasps,
    sample_grasps,
    why_no_grasp,
)

PER_PART = 3  # grasps kept of each part
WIDEST = 2.0  # longest side of a height map of 2 mm cells [m]; a larger one takes gigabytes with thirty parts
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameGrasp:
    """A grasp on a part found in a frame.

    Attributes:
        grasp: The grasp; its candidate is the index of the part's pose among the verified ones, best first.
        reachable: Whether the robot reaches it; None if no robot is known, or its base cannot stand beside the bin.
    """

    grasp: GraspCandidate
    reachable: bool | None


class GraspFinder:
    """Finds the grasps of a 2F-85 on the parts in frames.

    Attributes:
        part: Kind of part.
        jaw: Largest opening of the jaw [m]; the gripper's whole stroke if None.
        reach: Reach of the robot over the bin as it is believed to be; None if its base is not known.
    """

    def __init__(self, part: PartModel, *, jaw: float | None = None, reach: Reach | None = None) -> None:
        """Sample the part's grasps, which takes seconds the first time.

        Args:
            part: Kind of part.
            jaw: Largest opening of the jaw [m]; the gripper's whole stroke if None.
            reach: Reach of the robot; None if its base is not known.

        Raises:
            ValueError: There is no grasp on the part.
        """
        self.part, self.jaw, self.reach = part, jaw, reach
        self._gripper, self._grasps = gripper_model(jaw), sample_grasps(part, jaw=jaw)
        if len(self._grasps) == 0:
            raise ValueError(why_no_grasp(part, jaw=jaw))

    def find(self, frame: Frame, workspace: Workspace, poses: list[PoseEstimate]) -> list[FrameGrasp]:
        """Return up to three grasps on each part that are clear of everything else, best first.

        The approach is tilted against the bin's z axis by at most 50 degrees.

        Args:
            frame: Frame in which the parts were found.
            workspace: The bin as it was measured. Reach is judged over it, too; if the robot's base
                cannot stand beside it, a warning is logged.
            poses: Verified poses, best first.

        Raises:
            ValueError: The bin is too large for a height map.
        """
        if (longest := float(workspace.inner_size[:2].max())) > WIDEST:
            raise ValueError(
                f"grasps need a bin of at most {WIDEST:g} m, got {longest:.2f} m: state the bin by --bin, or keep a "
                "part of the image by --crop"
            )
        # The bin's frame stands in for the world: its z axis is the vertical, whatever the world's is.
        T_bin_world = invert_transform(workspace.T_world_bin)
        upright = Workspace(T_world_bin=np.eye(4), inner_size=workspace.inner_size)
        seen = replace(frame, T_world_cam=T_bin_world @ frame.T_world_cam)
        candidates = [self._candidate(seen, upright, pose) for pose in poses]
        scene = ObservedScene.from_frame(seen, candidates, upright, self._grasps.surface)
        ranked, _ = rank_grasps(scene, self._grasps, self._gripper, RankSettings(per_candidate=PER_PART))
        reach = self._reach_over(workspace) if ranked else None
        return [_in_world(grasp, workspace.T_world_bin, reach) for grasp in ranked]

    def _reach_over(self, workspace: Workspace) -> Reach | None:
        """Return the reach over a measured bin; None if no robot is known, or its base cannot stand beside it."""
        try:
            return None if self.reach is None else self.reach.at(workspace)
        except ValueError as error:
            _log.warning("reach is not known over the bin as it was measured: %s", error)
            return None

    def _candidate(self, frame: Frame, workspace: Workspace, pose: PoseEstimate) -> PoseCandidate:
        T_world_part = frame.T_world_cam @ pose.T_cam_part
        points_world = transform_points(T_world_part, np.asarray(self.part.mesh.vertices, np.float64))
        return PoseCandidate(
            T_world_part=T_world_part,
            centre_world=transform_points(T_world_part, self.part.centre[None])[0],
            score=pose.score,
            visible_fraction=pose.visible_fraction,
            top=float(workspace.to_bin(points_world)[:, 2].max()),
            fill=pose.visible_fraction,
        )


def _in_world(grasp: GraspCandidate, T_world_bin: Floats, reach: Reach | None) -> FrameGrasp:
    placed = replace(
        grasp, T_world_grasp=T_world_bin @ grasp.T_world_grasp, T_world_tcp=T_world_bin @ grasp.T_world_tcp
    )
    reachable = None if reach is None else reach.reaches(placed.T_world_tcp, placed.opening)
    return FrameGrasp(grasp=placed, reachable=reachable)
