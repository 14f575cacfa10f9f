"""The scene in one frame: its height map, and for each observed part the map without it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from binpick_env.candidates import PoseCandidate
from perception.frame import Frame, Workspace
from perception.geometry import Floats
from policies.grasping.heightmap import HeightMap


@dataclass(frozen=True, eq=False, kw_only=True)
class ObservedPart:
    """One observed part among the others.

    Attributes:
        surroundings: Height map of the scene without the part, which a gripper must not touch.
        covering: Number of known parts above the part.
        buried: Share of the part's outline over which something higher was measured.
    """

    surroundings: HeightMap
    covering: int
    buried: float


@dataclass(frozen=True, eq=False, kw_only=True)
class ObservedScene:
    """One frame, prepared for grasp planning. It is computed once a frame and passed on.

    Attributes:
        frame: Frame that was taken.
        candidates: Parts observed in the frame.
        workspace: Pose and inner size of the bin.
        heights: Height map of everything observed.
        parts: Each candidate among the others, in the candidates' order.
    """

    frame: Frame
    candidates: Sequence[PoseCandidate]
    workspace: Workspace
    heights: HeightMap
    parts: tuple[ObservedPart, ...]

    @classmethod
    def from_frame(
        cls,
        frame: Frame,
        candidates: Sequence[PoseCandidate],
        workspace: Workspace,
        surface_part: Floats,
        *,
        cell: float = 0.002,
        wall: float = 0.02,
    ) -> "ObservedScene":
        """Compute the scene in a frame.

        Args:
            frame: Frame whose depth the fingers must stay above.
            candidates: Parts observed in the frame.
            workspace: Pose and inner size of the bin.
            surface_part: (S, 3) dense points on the part's surface, part frame [m].
            cell: Edge length of a cell of the height map [m].
            wall: Thickness of the bin's walls [m].

        Note:
            3 ms for the map and 1.3 ms for each candidate.
        """
        heights = HeightMap.from_frame(frame, workspace, cell=cell, wall=wall)
        parts = tuple(_parts(heights, candidates, surface_part))
        return cls(frame=frame, candidates=candidates, workspace=workspace, heights=heights, parts=parts)


def _parts(scene: HeightMap, candidates: Sequence[PoseCandidate], surface_part: Floats) -> Iterator[ObservedPart]:
    if not candidates:
        return
    rasters = np.stack([scene.rasterise(surface_part, c.T_world_part) for c in candidates])
    owner = rasters.argmax(axis=0)
    highest = rasters.max(axis=0)
    runner_up = np.full_like(highest, -np.inf)
    if len(rasters) > 1:
        runner_up = np.partition(rasters, len(rasters) - 2, axis=0)[-2]
    for row, own in enumerate(rasters):
        outline = np.nonzero(np.isfinite(own))  # empty for an estimate beside the map, where no grasp is clear either
        # Dilated, because an edge cell may hold only the lower points of a flank.
        surface = cv2.dilate(own, np.ones((3, 3), np.uint8))[outline]
        # 3 % of the outline: with less, two parts lie side by side and their edges share cells.
        above = (rasters[:, outline[0], outline[1]] > surface + 0.002).sum(axis=1) > 0.03 * len(surface)
        buried = float((scene.measured[outline] > surface + 0.005).mean()) if len(surface) else 1.0
        others = np.where(owner == row, runner_up, highest)
        yield ObservedPart(surroundings=scene.without(own, others), covering=int(above.sum()), buried=buried)
