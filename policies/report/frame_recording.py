"""A recording of perceived frames for Rerun's viewer: clouds, segments, poses and grasps, one frame after the other.

The module needs Rerun, which comes with the extra ``viz``; it is imported only where something is recorded. All
entities are below ``world`` in the world frame [m]. The timeline is ``frame``, the number of the frame.
"""

from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from perception.geometry import Floats, quat_from_matrix, transform_points
from policies.frames import FrameRecord
from policies.frames.frame_record import frame_lines
from policies.frames.shading import shown_grey
from policies.grasping import GraspCandidate
from policies.report.recording import check_recording, draft_of
from policies.report.recording_motion import instance_poses, pack
from policies.report.recording_scene import (
    frame_cloud,
    is_whole,
    jaw_lines,
    log_camera,
    segment_points,
    shaded_mesh,
)

_POSE, _BIN, _BACKGROUND = (80, 190, 120), (160, 164, 172), (38, 40, 46)
_LABEL_RADIUS = 0.001  # drawn radius of the points that carry the scores [m]


class FrameRecording:
    """Writes perceived frames into a Rerun file; the file appears when it is complete.

    Use it as a context manager: after an exception there is no file.
    """

    def __init__(self, path: Path) -> None:
        """Check that the file can be written, and open it.

        Args:
            path: Path of the .rrd; its folder is made.

        Raises:
            ValueError: The file cannot be written.
            ModuleNotFoundError: The extra ``viz`` is not installed.
        """
        check_recording(path)
        self._path, self._count = path, 0
        self._stream = rr.RecordingStream("binpick")
        self._stream.save(draft_of(path), default_blueprint=_blueprint())
        self._stream.set_log_time_enabled(False)  # wall clock has no meaning here

    def __enter__(self) -> "FrameRecording":
        return self

    def add(self, record: FrameRecord) -> None:
        """Write a frame, the segments and verified poses found in it, the grasps on them, and what is printed of it."""
        stream = self._stream
        frame = replace(record.frame, grey=shown_grey(record.frame), T_world_cam=record.T_world_cam)
        if self._count == 0:
            self._log_shape(record)
        stream.set_time("frame", sequence=self._count)
        self._count += 1
        log_camera(stream, frame)
        stream.log("world/seen/cloud", frame_cloud(frame))
        stream.log("world/seen/segments", segment_points(frame, record.seen))
        T_world: Floats = np.array([frame.T_world_cam @ pose.T_cam_part for pose in record.seen.poses])
        T_world = T_world.reshape(-1, 4, 4)
        translations, quaternions, scales = instance_poses(pack(T_world))
        poses = rr.InstancePoses3D(translations=translations, quaternions=quaternions, scales=scales)
        stream.log("world/seen/poses", poses)
        centre = record.perceiver.part.centre[None]
        centres = np.array([transform_points(T, centre)[0] for T in T_world]).reshape(-1, 3)
        labels = [f"{k}: {pose.score:.2f}" for k, pose in enumerate(record.seen.poses, start=1)]
        stream.log("world/seen/scores", rr.Points3D(centres, labels=labels, radii=_LABEL_RADIUS, colors=_POSE))
        self._log_bin(record)
        self._log_grasps(record)
        stream.log("report", rr.TextDocument("\n".join(frame_lines(record))))

    def _log_shape(self, record: FrameRecord) -> None:
        """Write the part's shape, which is drawn at every pose."""
        self._stream.send_recording_name(f"frames of {record.perceiver.part.name}")
        mesh = record.perceiver.part.mesh
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
        self._stream.log("world/seen/poses", shaded_mesh(vertices, faces, _POSE), static=True)

    def _log_bin(self, record: FrameRecord) -> None:
        """Write the inner box of the bin; without one, that of the frame before is cleared."""
        workspace = record.workspace
        if workspace is None:
            self._stream.log("world/bin", rr.Clear(recursive=False))
            return
        T, size = workspace.T_world_bin, workspace.inner_size
        middle = transform_points(T, np.array([[0.0, 0.0, size[2] / 2]]))
        turn = np.roll(quat_from_matrix(T[None, :3, :3]), -1, axis=1)
        self._stream.log("world/bin", rr.Boxes3D(centers=middle, half_sizes=[size / 2], quaternions=turn, colors=_BIN))

    def _log_grasps(self, record: FrameRecord) -> None:
        """Write the best grasp on each part that is not out of reach."""
        best: dict[int, GraspCandidate] = {}
        for found in record.grasps or ():
            if found.reachable is not False:
                best.setdefault(found.grasp.candidate, found.grasp)
        self._stream.log("world/grasps", jaw_lines(*best.values()))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        draft = draft_of(self._path)
        try:
            if error is None:
                self._stream.flush()
            self._stream.disconnect()
            if error is None:
                if not is_whole(draft):
                    raise OSError("the recording could not be written to its end; is the disk full?")
                draft.replace(self._path)
        finally:
            draft.unlink(missing_ok=True)


def _blueprint() -> rrb.Blueprint:
    """Return the views: the scene, the camera's image, and what is printed of the frame."""
    scene = rrb.Spatial3DView(name="The frame", origin="world", background=_BACKGROUND, line_grid=False)
    drawn_on_image = ["$origin/**", "/world/seen/segments", "/world/grasps"]
    camera = rrb.Spatial2DView(name="Camera", origin="world/seen/camera", contents=drawn_on_image)
    report = rrb.TextDocumentView(name="Report", origin="report")
    layout = rrb.Horizontal(scene, rrb.Vertical(camera, report), column_shares=[2, 1])
    return rrb.Blueprint(layout, rrb.TimePanel(timeline="frame", state="collapsed"), collapse_panels=True)
