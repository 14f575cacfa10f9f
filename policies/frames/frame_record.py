"""What was found in a frame, as JSON values and as text."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.jobs.text_tables import columns, number, percent
from perception.capture import ReadReport
from perception.diagnosis import FrameReport
from perception.frame import Frame
from perception.pipeline import Perception
from perception.pose.pose_estimate import PoseEstimate
from policies.frames.frame_perceiver import FramePerceiver

VERSION = 1  # version of the keys of a file of records
HEADER = ("pose", "score", "surface", "visible", "x [mm]", "y [mm]", "z [mm]", "verified")
Values = dict[str, Any]


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameRecord:
    """What was found in a frame.

    Attributes:
        path: File of the frame.
        frame: The frame.
        reading: What the reading of the file found.
        seen: Result of the pipeline.
        perceiver: Part, bin and weights that it was found with.
    """

    path: Path
    frame: Frame
    reading: ReadReport
    seen: Perception
    perceiver: FramePerceiver

    @property
    def poses(self) -> list[tuple[PoseEstimate, bool]]:
        """Best pose of each group with whether it is verified: verified ones first, then by score."""
        verified = {id(pose) for pose in self.seen.poses}
        others = [pose for pose in self.seen.estimates if pose is not None and id(pose) not in verified]
        others.sort(key=lambda pose: -pose.score)
        return [*((pose, True) for pose in self.seen.poses), *((pose, False) for pose in others)]

    def values(self) -> Values:
        """Return the record as JSON values."""
        height, width = self.frame.depth.shape
        part, workspace = self.perceiver.part, self.perceiver.workspace
        return {
            "frame": str(self.path),
            "width": width,
            "height": height,
            "part": {
                "name": part.name,
                "d_max": part.d_max,
                "origin_in_file": list(self.perceiver.origin_in_file),
            },
            "weights": asdict(self.perceiver.weights),
            "bin": None
            if workspace is None
            else {"T_world_bin": workspace.T_world_bin.tolist(), "inner_size": workspace.inner_size.tolist()},
            "T_world_cam": self.frame.T_world_cam.tolist(),
            "K": self.frame.K.tolist(),
            "reading": asdict(self.reading),
            "poses": [self._pose(pose, verified) for pose, verified in self.poses],
            "report": None if self.seen.report is None else asdict(self.seen.report),
            "ms": self.seen.ms,
        }

    def _pose(self, pose: PoseEstimate, verified: bool) -> Values:
        T_world_part = self.frame.T_world_cam @ pose.T_cam_part
        return {
            "T_cam_part": np.asarray(pose.T_cam_part).tolist(),
            "T_world_part": T_world_part.tolist(),
            "score": float(pose.score),
            "surface_score": float(pose.surface_score),
            "visible_fraction": float(pose.visible_fraction),
            "verified": verified,
        }


def frame_lines(record: FrameRecord) -> list[str]:
    """Return what is printed about a frame: what was read, the facts and causes of its report, its poses."""
    frame, reading = record.frame, record.reading
    height, width = frame.depth.shape
    lines = [
        f"{record.path}: {reading.source}, {width} x {height} px, {percent(reading.measured_fraction)} with depth, "
        f"grey from {reading.grey}"
    ]
    if record.perceiver.workspace is None:
        lines.append("no bin limits the poses: the box of all measured depths stands in for it")
    if record.seen.report is not None:
        lines += str(record.seen.report).splitlines()
    if not record.seen.poses:
        lines.append(f"no part was found: {_reason(record.seen.report)}")
    if record.poses:
        lines.append(columns([HEADER, *_rows(record.poses)]))
    return lines


def _rows(poses: Sequence[tuple[PoseEstimate, bool]]) -> list[tuple[str, ...]]:
    """Return the rows of the table; positions are those of the part's origin in the camera frame."""
    return [
        (
            str(k),
            number(pose.score, 3),
            number(pose.surface_score, 3),
            percent(pose.visible_fraction),
            *(number(1000 * float(value), 1) for value in pose.T_cam_part[:3, 3]),
            "yes" if verified else "no",
        )
        for k, (pose, verified) in enumerate(poses, start=1)
    ]


def _reason(report: FrameReport | None) -> str:
    """Return why no part was found."""
    above = report is not None and bool(report.causes)
    if report is None or report.boundary_points == 0:
        what = "there are no boundary points" + ("" if above else ", as in an empty bin")
    elif report.poses is None or report.poses.groups == 0:
        what = f"the segmentation grouped none of the {report.boundary_points} boundary points"
    else:
        what = f"none of the {report.poses.groups} groups has a verified pose"
    return f"{what}; the likely causes stand above" if above else what
