"""A cloud of boundary points, segmented by a network over points."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from perception.geometry import Floats
from perception.instance import Instance
from perception.metrics.average_precision import ApSummary, ap_summary
from perception.metrics.matching import MIN_REGION, match_scene
from perception.runtime.threads import default_threads, use_threads
from perception.segmentation.point_files import LabelledPoints, read_points
from perception.segmentation.predictor import SegmentationPredictor

Axes = Literal["opencv", "opengl"]
LARGEST = 1000.0  # largest extent of a cloud, in units of d_max; a larger one is in another unit


@dataclass(frozen=True, kw_only=True)
class CloudSource:
    """How the points of a file relate to the camera and to the part."""

    path: Path  # PLY, PCD or text file
    d_max: float  # largest extent of the part [m]
    scale: float = 1.0  # length of one unit of the file's coordinates [m]
    axes: Axes = "opencv"  # y down and z forward, or y up and z towards the camera

    def __post_init__(self) -> None:
        for name in ("d_max", "scale"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name)}")
        if self.axes not in get_args(Axes):
            raise ValueError(f"axes must be one of {', '.join(get_args(Axes))}, got {self.axes!r}")

    def in_camera_frame(self, points: Floats) -> Floats:
        """Return (N, 3) points of the file in the camera frame [m].

        Raises:
            ValueError: The cloud is too large for parts of this size.
        """
        points_cam = points * self.scale * (1.0 if self.axes == "opencv" else np.array([1.0, -1.0, -1.0]))
        if (extent := float(np.ptp(points_cam, axis=0).max())) > LARGEST * self.d_max:
            raise ValueError(
                f"{self.path.name} spans {extent:.4g} m, too much for parts of {self.d_max:.4g} m: state the length of "
                "its unit by --scale (0.001 for millimetres), and --d-max in metres"
            )
        return points_cam


@dataclass(frozen=True, eq=False, kw_only=True)
class SegmentedCloud:
    """The instances in a cloud.

    Attributes:
        source: File, and how it was read.
        loaded: Points and labels of the file.
        points_cam: (M, 3) measured points in the camera frame [m].
        instances: Groups of the measured points, best first.
        ap: Average precision against the file's labels; None without labels.
        ms: Wall clock of the segmentation [ms].
    """

    source: CloudSource
    loaded: LabelledPoints
    points_cam: Floats
    instances: list[Instance]
    ap: ApSummary | None
    ms: float

    def instances_of_file(self) -> list[Instance]:
        """Return the instances with indices into all points of the file."""
        rows = np.flatnonzero(self.loaded.measured)
        return [Instance(point_idx=rows[each.point_idx], score=each.score) for each in self.instances]


def segment_cloud(source: CloudSource, predictor: SegmentationPredictor) -> SegmentedCloud:
    """Read a cloud and segment it.

    Args:
        source: File of the cloud.
        predictor: Predictor with a network over points.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is damaged or holds fewer than 3 points, it is too large for the parts, or the network
            needs more than points.
    """
    loaded = read_points(source.path)
    points_cam = source.in_camera_frame(loaded.points[loaded.measured])
    started = time.perf_counter()
    with use_threads(default_threads()):
        instances = predictor.predict(points_cam, d_max=source.d_max)
    ms = 1000 * (time.perf_counter() - started)
    truth = loaded.truth()
    return SegmentedCloud(
        source=source,
        loaded=loaded,
        points_cam=points_cam,
        instances=instances,
        ap=None if truth is None else ap_summary([match_scene(truth, instances)]),
        ms=ms,
    )


def cloud_lines(cloud: SegmentedCloud) -> list[str]:
    """Return what to print about a segmented cloud."""
    count, grouped = len(cloud.points_cam), sum(len(each.point_idx) for each in cloud.instances)
    lost = len(cloud.loaded.points) - count
    lines = [
        f"points    {count}" + (f", and {lost} that were not measured" if lost else ""),
        f"instances {len(cloud.instances)}, with {grouped} of the points, in {cloud.ms:.0f} ms",
    ]
    truth, ap = cloud.loaded.truth(), cloud.ap
    if truth is None or ap is None:
        return lines
    counted = int(truth.counted(MIN_REGION).sum())
    if counted == 0:
        return [*lines, f"no AP: none of {len(truth.ignored)} labelled parts has the {MIN_REGION} points to count"]
    found = f"AP {ap.ap:.3f}  AP50 {ap.ap50:.3f}  AP75 {ap.ap75:.3f}"
    return [*lines, f"{found}  over {counted} labelled parts of at least {MIN_REGION} points"]
