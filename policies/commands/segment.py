"""``binpick segment``: the parts in a cloud of boundary points alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from binpick_env.parts.unit import Unit
from policies.commands.command_line import exit_code, parse

if TYPE_CHECKING:
    from perception.part import PartModel
    from policies.clouds import SegmentedCloud


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Label the parts in a cloud of boundary points, without an image. State the part by --part or its size by --d-max.

    Clouds are PLY, PCD, or text with lines x y z, x y z label or x y z score label, where negative labels stand for no
    part. Labels in the file are compared with those found. The cloud must show parts from above, as a camera sees them.
    """

    cloud: Annotated[Path, tyro.conf.Positional]
    d_max: float | None = None  # largest extent of the part [m]; that of --part unless given
    # part_a, part_b, part_c, tee, bracket, generated:FAMILY:INDEX, or the path of an STL, OBJ, PLY, OFF, GLB, 3MF or
    # STEP file
    part: str | None = None
    unit: Unit | None = None  # length unit of a part file's coordinates; metres or millimetres, guessed, unless given
    scale: float = 1.0  # length of one unit of the cloud's coordinates [m]; 0.001 for millimetres
    axes: Literal["opencv", "opengl"] = "opencv"  # axes of the cloud: y down and z forward, or y up and z to the camera
    # network over points, whose shipped or installed weights are used
    network: Literal["dgcnn-context", "dgcnn-sgpn"] = "dgcnn-context"
    weights: Path | None = None  # weights of a network over points; those of --network unless given
    poses: bool = False  # also estimate poses of --part by the edges alone, into poses.json
    out: Path | None = None  # folder of labels.txt and report.html; runs/segment-CLOUD unless given

    def folder(self) -> Path:
        """Return where the results are written."""
        return self.out or Path("runs") / f"segment-{self.cloud.stem}"

    def model(self) -> "PartModel | None":
        """Return the part; None where only its size is given."""
        from binpick_env.parts.part import load_part

        return None if self.part is None else load_part(self.part, unit=self.unit).model


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and segment; return the exit code."""
    return run(parse(Arguments, "segment", arguments))


def run(args: Arguments) -> int:
    """Segment; return the exit code."""
    return exit_code(lambda: _segment(args), (ValueError, OSError))


def _segment(args: Arguments) -> str:
    from perception.segmentation.point_files import write_labels
    from perception.segmentation.predictor import SegmentationPredictor
    from perception.segmentation.weights import find_weights, general_weights
    from policies.clouds import CloudSource, cloud_lines, segment_cloud, write_cloud_report

    part = args.model()
    if args.poses and part is None:
        raise ValueError("--poses needs --part, the part whose poses are wanted")
    d_max = args.d_max if part is None or args.d_max is not None else part.d_max
    if d_max is None:
        raise ValueError("the size of the part must be known: give --d-max [m] or --part")
    source = CloudSource(path=args.cloud, d_max=d_max, scale=args.scale, axes=args.axes)
    weights = args.weights
    if weights is None:
        weights = general_weights(args.network) if part is None else find_weights(part, args.network).path
    cloud = segment_cloud(source, SegmentationPredictor.from_file(weights))
    labels, report = args.folder() / "labels.txt", args.folder() / "report.html"
    write_labels(labels, cloud.loaded.points, cloud.instances_of_file())
    write_cloud_report(report, cloud, weights.name)
    lines = [*cloud_lines(cloud), f"network   {weights}", f"labels    {labels}", f"report    {report}"]
    if args.poses and part is not None:
        lines += _poses(args, cloud, part)
    return "\n".join(lines)


def _poses(args: Arguments, cloud: "SegmentedCloud", part: "PartModel") -> list[str]:
    """Estimate the poses in a cloud, write them, and return the lines to print."""
    from perception.pose.edge_estimator import EdgePoseEstimator
    from perception.runtime.files import json_text, write_atomically
    from perception.runtime.threads import default_threads, use_threads
    from policies.clouds import pose_lines, pose_values

    with use_threads(default_threads()):
        poses = EdgePoseEstimator(part).estimate(cloud.points_cam, cloud.instances)
    path = args.folder() / "poses.json"
    write_atomically(path, json_text(pose_values(cloud, poses)))
    return [*pose_lines(poses), f"poses     {path}"]
