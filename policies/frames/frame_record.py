"""What was found in a frame, as JSON values and as text."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.jobs.text_tables import columns, number, percent
from perception.capture import ReadReport
from perception.diagnosis import FrameReport
from perception.frame import Frame, Workspace
from perception.geometry import Floats, invert_transform
from perception.pipeline import Perception
from perception.pose.pose_estimate import PoseEstimate
from policies.frames.frame_perceiver import FramePerceiver
from policies.frames.grasp_finder import FrameGrasp

VERSION = 1  # version of the keys of a file of records
HEADER = ("pose", "score", "surface", "visible", "x [mm]", "y [mm]", "z [mm]", "verified")
GRASP_HEADER = ("pose", "grasp", "width [mm]", "opening [mm]", "x [mm]", "y [mm]", "z [mm]", "reachable")
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
        grasps: Grasps on the verified poses, best first; None if none were searched.
    """

    path: Path
    frame: Frame
    reading: ReadReport
    seen: Perception
    perceiver: FramePerceiver
    grasps: Sequence[FrameGrasp] | None = None

    @property
    def poses(self) -> list[tuple[PoseEstimate, bool]]:
        """Best pose of each group with whether it is verified, verified ones first, then by score."""
        verified = {id(pose) for pose in self.seen.poses}
        others = [pose for pose in self.seen.estimates if pose is not None and id(pose) not in verified]
        others.sort(key=lambda pose: -pose.score)
        return [*((pose, True) for pose in self.seen.poses), *((pose, False) for pose in others)]

    @property
    def workspace(self) -> Workspace | None:
        """The bin that limited the poses, as it was measured or else as it was believed to be; None if none did."""
        found = self.seen.bin is not None and self.seen.bin.reliable
        return self.seen.workspace if found or self.perceiver.workspace is not None else None

    @property
    def T_world_cam(self) -> Floats:
        """(4, 4) pose of the camera, that of the frame or the one that the bin corrected."""
        return self.frame.T_world_cam if self.seen.T_world_cam is None else self.seen.T_world_cam

    def values(self) -> Values:
        """Return the record as JSON values."""
        height, width = self.frame.depth.shape
        part, workspace = self.perceiver.part, self.workspace
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
            "T_world_cam": self.T_world_cam.tolist(),
            "K": self.frame.K.tolist(),
            "reading": asdict(self.reading),
            "poses": [self._pose(pose, verified) for pose, verified in self.poses],
            "report": None if self.seen.report is None else asdict(self.seen.report),
            "ms": self.seen.ms,
            "grasps": None if self.grasps is None else [_grasp_values(each) for each in self.grasps],
        }

    def _pose(self, pose: PoseEstimate, verified: bool) -> Values:
        T_world_part = self.T_world_cam @ pose.T_cam_part
        return {
            "T_cam_part": np.asarray(pose.T_cam_part).tolist(),
            "T_world_part": T_world_part.tolist(),
            "score": float(pose.score),
            "surface_score": float(pose.surface_score),
            "visible_fraction": float(pose.visible_fraction),
            "expected_error": asdict(pose.expected_error),
            "verified": verified,
        }


def _grasp_values(found: FrameGrasp) -> Values:
    grasp = found.grasp
    return {
        "pose": grasp.candidate,
        "T_world_grasp": grasp.T_world_grasp.tolist(),
        "T_world_tcp": grasp.T_world_tcp.tolist(),
        "width": grasp.width,
        "opening": grasp.opening,
        "score": grasp.score,
        "reachable": found.reachable,
    }


def frame_lines(record: FrameRecord) -> list[str]:
    """Return what is printed about a frame: what was read, the facts and causes of its report, its poses."""
    frame, reading = record.frame, record.reading
    height, width = frame.depth.shape
    lines = [
        f"{record.path}: {reading.source}, {width} x {height} px, {percent(reading.measured_fraction)} with depth, "
        f"{'no grey image' if reading.grey == 'none' else f'grey from {reading.grey}'}"
    ]
    report = [] if record.seen.report is None else str(record.seen.report).splitlines()
    if record.workspace is None:  # after the reason, which a report of a bin that was looked for begins with
        first = record.seen.report is not None and record.seen.report.bin is not None
        report.insert(int(first), "no bin limits the poses: the box of all measured depths stands in for it")
    lines += report
    if not record.seen.poses:
        lines.append(f"no part was found: {_reason(record.seen.report)}")
    if record.poses:
        lines.append(columns([HEADER, *_rows(record.poses)]))
    if record.grasps is not None and record.seen.poses:
        lines += _grasp_lines(record, record.grasps)
    return lines


def _rows(poses: Sequence[tuple[PoseEstimate, bool]]) -> list[tuple[str, ...]]:
    """Return the rows of the table; positions are those of the part's origin in the camera frame."""
    return [
        (
            str(k),
            number(_rounded_down(pose.score), 3),
            number(_rounded_down(pose.surface_score), 3),
            percent(pose.visible_fraction),
            *(number(1000 * float(value), 1) for value in pose.T_cam_part[:3, 3]),
            "yes" if verified else "no",
        )
        for k, (pose, verified) in enumerate(poses, start=1)
    ]


def _rounded_down(score: float) -> float:
    """Return a score in thousandths, so that none below the bound of verified poses is printed as the bound."""
    return math.floor(1000 * score + 1e-9) / 1000


def _grasp_lines(record: FrameRecord, grasps: Sequence[FrameGrasp]) -> list[str]:
    """Return how many parts can be gripped, and the best grasp on each; positions are those of the fingertips' middle.

    Grasps out of reach are listed only where there is no other on the part.
    """
    best: dict[int, FrameGrasp] = {}
    for found in sorted(grasps, key=lambda found: found.reachable is False):
        best.setdefault(found.grasp.candidate, found)
    within = sum(found.reachable is True for found in best.values())
    known = any(found.reachable is not None for found in best.values())
    count = f"grasps clear of everything else on {len(best)} of {len(record.seen.poses)} parts"
    lines = [f"{count}, {within} of these within reach" if known else count]
    T_cam_world = invert_transform(record.T_world_cam)
    rows: list[tuple[str, ...]] = [GRASP_HEADER]
    for pose, found in sorted(best.items()):
        grasp, reachable = found.grasp, {None: "unknown", True: "yes", False: "no"}[found.reachable]
        place = 1000 * (T_cam_world @ grasp.T_world_grasp)[:3, 3]
        sizes = (number(1000 * grasp.width, 1), number(1000 * grasp.opening, 1))
        rows.append((str(pose + 1), number(grasp.score, 3), *sizes, *(number(float(v), 1) for v in place), reachable))
    return [*lines, columns(rows)] if best else lines


def _reason(report: FrameReport | None) -> str:
    """Return why no part was found."""
    # What lies outside the image does not explain that nothing is found inside.
    above = report is not None and any(cause.name != "partly_outside" for cause in report.causes)
    if report is None or report.boundary_points == 0:
        what = "there are no boundary points" + ("" if above else ", as in an empty bin")
    elif report.poses is None or report.poses.groups == 0:
        what = f"the segmentation grouped none of the {report.boundary_points} boundary points"
    else:
        what = f"none of the {report.poses.groups} groups has a verified pose"
    return f"{what}; the likely causes stand above" if above else what
