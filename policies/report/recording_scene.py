"""The contents of a recording: the cell, frames and what perception found in them, grasps, and the motion.

The module needs Rerun, which comes with the extra ``viz``; it is imported only where something is recorded. All
entities are below ``world`` in the world frame [m]. The timelines are ``time``, simulated [s], and ``pick``, the number
of the decision.
"""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import trimesh
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from binpick_env.camera.raster import corner_normals
from binpick_env.camera.view import visible_geoms
from binpick_env.cell.scene import BIN_BODY
from binpick_env.env import BinPickEnv
from binpick_env.evaluation.segmentation.pictures import part_colours
from perception.frame import Frame
from perception.geometry import Floats, deproject_depth, matrix_from_quat, transform_points
from perception.instance import labels_of
from policies.grasping.outcomes import GraspCandidate, PickResult
from policies.report.recording_motion import Motion, instance_poses, pack

if TYPE_CHECKING:  # it imports the pose estimator's kernels, which the oracle does not need
    from perception.pipeline import Perception

Vector = tuple[float, float, float]
CLOUD_POINTS = 60_000  # largest number of points of a frame, on a regular grid of its pixels
JPEG_QUALITY = 80
_POSE, _TRUE, _NO_SEGMENT = (80, 190, 120), (160, 164, 172), (110, 110, 110)
_BACKGROUND = (38, 40, 46)
_JAW, _APPROACH = (255, 140, 40), (235, 235, 235)
_FINGER, _PAD = 0.04, 0.011  # drawn length of a finger, half the width of a pad [m]
_APPROACH_LENGTH = 0.10  # drawn length of the approach [m]
_NORMAL_STEPS = 20  # corners of a vertex share a normal if its coordinates agree to a twentieth


class SceneLog:
    """Writes the events of a bin into a Rerun file."""

    def __init__(self, path: Path, env: BinPickEnv) -> None:
        """Open the file and write what does not change; this takes about a second, mostly for the robot's meshes.

        Args:
            path: Path of the rrd file.
            env: The environment, after its reset.
        """
        self._path, self._env = path, env
        self._stream = rr.RecordingStream("binpick")
        self._stream.save(path, default_blueprint=_blueprint(env))
        self._stream.send_recording_name(f"a bin of {env.part.model.name}")
        self._stream.set_log_time_enabled(False)  # wall clock has no meaning here
        self._motion = Motion(env.simulation)
        self._log_shapes()
        for entity, name in (("gripper/closed", "closed"), ("gripper/target", "target"), ("force", "force [N]")):
            self._stream.log(entity, rr.SeriesLines(names=name), static=True)

    def _log_shapes(self) -> None:
        """Write the shapes of robot and cell, and the part's shape for true and for estimated poses."""
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        simulation = self._env.simulation
        geoms = visible_geoms(simulation.model)
        for body in np.unique(simulation.model.geom_bodyid[geoms[simulation.part_of_geom[geoms] < 0]]):
            self._log_body(int(body))
        mesh = self._env.part.model.mesh
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
        self._stream.log("world/parts", shaded_mesh(vertices, faces, _TRUE), static=True)
        self._stream.log("world/seen/poses", shaded_mesh(vertices, faces, _POSE), static=True)

    def _log_body(self, body: int) -> None:
        """Write a body's visible geoms, and its pose if it never moves."""
        simulation = self._env.simulation
        model, data = simulation.model, simulation.data
        path = self._motion.paths.get(body)
        if path is None:
            path = f"world/cell/{model.body(body).name}"
            fixed = rr.Transform3D(translation=data.xpos[body], mat3x3=data.xmat[body].reshape(3, 3))
            self._stream.log(path, fixed, static=True)
        for k, geom in enumerate(g for g in visible_geoms(model) if model.geom_bodyid[g] == body):
            self._stream.log(f"{path}/{k}", geom_mesh(model, int(geom)), static=True)

    def step(self) -> None:
        """Collect the present poses of robot and parts."""
        self._motion.add()

    def frame(self, pick: int) -> None:
        """Write the last frame, what perception found in it, and the present poses of robot and parts.

        Args:
            pick: Number of the decision that will be made on the frame.
        """
        env, stream = self._env, self._stream
        self._at(env.simulation.time, pick)
        log_camera(stream, env.frame)
        stream.log("world/seen/cloud", frame_cloud(env.frame))
        if env.observed.perception is not None:
            stream.log("world/seen/segments", segment_points(env.frame, env.observed.perception))
        T_world: Floats = np.array([each.T_world_part for each in env.candidates]).reshape(-1, 4, 4)
        translations, quaternions, scales = instance_poses(pack(T_world))
        poses = rr.InstancePoses3D(translations=translations, quaternions=quaternions, scales=scales)
        stream.log("world/seen/poses", poses)
        labels = [f"{each.score:.2f}" for each in env.candidates]
        centres = np.array([each.centre_world for each in env.candidates]).reshape(-1, 3)
        stream.log("world/seen/scores", rr.Points3D(centres, labels=labels, radii=0.001, colors=_POSE))
        stream.log("world/grasp", rr.LineStrips3D([]))  # that of the last decision is over
        self._motion.log_now(stream)

    def decision(self, pick: int, start: float, result: PickResult) -> None:
        """Write a decision and how it ended.

        Args:
            pick: Number of the decision.
            start: Simulated time at which it was made [s].
            result: What was decided, and how the attempt ended.
        """
        stream = self._stream
        self._at(start, pick)
        stream.log("world/grasp", jaw_lines(result.grasp) if result.grasp is not None else rr.LineStrips3D([]))
        self._at(self._env.simulation.time, pick)
        if result.push is not None:
            text, level = f"pick {pick}: push, {result.push}", rr.TextLogLevel.INFO
        elif result.outcome is None:
            text, level = f"pick {pick}: nothing tried, {result.abstention}", rr.TextLogLevel.WARN
        else:
            text, level = f"pick {pick}: {result.outcome}", rr.TextLogLevel.INFO
            level = level if result.success else rr.TextLogLevel.ERROR
        stream.log("log", rr.TextLog(text.replace("_", " "), level=level))

    def close(self) -> None:
        """Write the motion and close the file.

        Raises:
            OSError: The file is incomplete.
        """
        self._motion.send(self._stream)
        self._stream.flush()
        self._stream.disconnect()
        if not is_whole(self._path):
            raise OSError("the recording could not be written to its end; is the disk full?")

    def abandon(self) -> None:
        """Close the file without the motion."""
        self._stream.disconnect()

    def _at(self, time: float, pick: int) -> None:
        self._stream.set_time("time", duration=time)
        self._stream.set_time("pick", sequence=pick)


def is_whole(path: Path) -> bool:
    """Return whether a recording is complete; Rerun does not report that the disk was full."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings of missing data
            RrdReader(path).store()
    except (OSError, RuntimeError, ValueError):
        return False
    return True


def geom_mesh(model: mujoco.MjModel, geom: int) -> rr.Mesh3D:
    """Return a mesh or box geom with its colour, in the frame of its body."""
    mesh, material = model.geom_dataid[geom], model.geom_matid[geom]
    if mesh >= 0:
        vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        vertices = np.array(model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]], np.float64)
        faces = np.array(model.mesh_face[face : face + model.mesh_facenum[mesh]], np.int32)
    else:
        box = trimesh.creation.box(extents=2 * model.geom_size[geom])
        vertices, faces = np.asarray(box.vertices, np.float64), np.asarray(box.faces, np.int32)
    rotation = matrix_from_quat(model.geom_quat[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    colour = (255 * rgba[:3]).astype(int)
    return shaded_mesh(vertices @ rotation.T + model.geom_pos[geom], faces, colour.tolist())


def shaded_mesh(vertices: Floats, faces: NDArray[np.int32], colour: tuple[int, ...] | list[int]) -> rr.Mesh3D:
    """Return a mesh with normals, which a viewer needs for shading; vertices are split along sharp edges only.

    Args:
        vertices: (V, 3) positions [m]; vertices at the same position are merged.
        faces: (T, 3) indices of vertices.
        colour: Red, green and blue, 0 to 255.
    """
    places, of = np.unique(vertices, axis=0, return_inverse=True)
    corners = of.reshape(-1)[faces]
    normals = corner_normals(places, corners.astype(np.int32)).reshape(-1, 3)
    keys = np.column_stack([corners.reshape(-1), np.rint(_NORMAL_STEPS * normals).astype(np.int64)])
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return rr.Mesh3D(
        vertex_positions=places[keys[first, 0]],
        vertex_normals=normals[first],
        triangle_indices=index.reshape(-1, 3),
        albedo_factor=colour,
    )


def jaw_lines(*grasps: GraspCandidate) -> rr.LineStrips3D:
    """Return lines of the open jaws (thin), the closed jaws (thick) and the last 10 cm of the approaches."""
    lines: list[Floats] = []
    radii: list[float] = []
    colours: list[tuple[int, int, int]] = []
    for grasp in grasps:
        strips: list[list[Vector]] = [[(0, 0, -_APPROACH_LENGTH), (0, 0, -_FINGER)]]
        radii.append(0.0004)
        colours.append(_APPROACH)
        for gap, radius in ((grasp.opening, 0.0004), (grasp.width, 0.001)):
            half = gap / 2
            strips.append([(0, -half, 0), (0, -half, -_FINGER), (0, half, -_FINGER), (0, half, 0)])
            strips += [[(-_PAD, side, 0), (_PAD, side, 0)] for side in (-half, half)]
            radii += 3 * [radius]
            colours += 3 * [_JAW]
        lines += [transform_points(grasp.T_world_grasp, np.array(strip, np.float64)) for strip in strips]
    return rr.LineStrips3D(lines, radii=radii, colors=colours)


def frame_cloud(frame: Frame) -> rr.Points3D:
    """Return the frame's points on a regular grid of pixels, in the image's grey."""
    step = max(1, int(np.ceil(np.sqrt(frame.valid.sum() / CLOUD_POINTS))))
    seen = frame.valid[::step, ::step]
    points_cam = deproject_depth(frame.K, frame.depth)[::step, ::step][seen]
    grey = np.repeat(frame.grey[::step, ::step][seen][:, None], 3, axis=1)
    pitch = step * float(np.median(points_cam[:, 2])) / float(frame.K[0, 0]) if len(points_cam) else 0.0
    return rr.Points3D(transform_points(frame.T_world_cam, points_cam), colors=grey, radii=0.6 * pitch)


def segment_points(frame: Frame, perception: "Perception") -> rr.Points3D:
    """Return the boundary points in the colours of their segments."""
    labels = labels_of(perception.segments, len(perception.boundary))
    colours = np.vstack([part_colours(len(perception.segments))[:, ::-1], [_NO_SEGMENT]])[labels]
    points_world = transform_points(frame.T_world_cam, perception.boundary.points_cam)
    return rr.Points3D(points_world, colors=colours, radii=rr.Radius.ui_points(1.5))


def log_camera(stream: rr.RecordingStream, frame: Frame) -> None:
    """Write the pose and the matrix of a frame's camera, and its grey image."""
    height, width = frame.grey.shape
    T = frame.T_world_cam
    pinhole = rr.Pinhole(image_from_camera=frame.K, width=width, height=height, image_plane_distance=0.08)
    stream.log("world/seen/camera", pinhole, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
    stream.log("world/seen/camera/image", rr.Image(frame.grey, color_model="L").compress(JPEG_QUALITY))


def _blueprint(env: BinPickEnv) -> rrb.Blueprint:
    """Return the views: the cell, what the robot sees, its camera's image, jaw and force, and the outcomes."""
    bin_world = env.workspace.T_world_bin[:3, 3]
    cell = _view("The cell", ["$origin/**", "- $origin/seen/**"], bin_world, (0.95, -0.95, 0.75))
    seen_contents = ["$origin/seen/**", "$origin/grasp", f"$origin/cell/{BIN_BODY}/**"]
    seen = _view("What the robot sees", seen_contents, bin_world, (0.22, -0.3, 0.55))
    drawn_on_image = ["$origin/**", "/world/seen/segments", "/world/grasp"]
    below = rrb.Horizontal(
        rrb.Spatial2DView(name="Camera", origin="world/seen/camera", contents=drawn_on_image),
        rrb.TimeSeriesView(name="Jaw, 0 open to 1 closed", origin="gripper"),
        rrb.TimeSeriesView(name="Contact force on the robot [N]", origin="force"),
        rrb.TextLogView(name="Outcomes", origin="log"),
    )
    time = rrb.TimePanel(timeline="time", state="collapsed")
    return rrb.Blueprint(rrb.Vertical(rrb.Horizontal(cell, seen), below, row_shares=[2, 1]), time, collapse_panels=True)


def _view(
    name: str, contents: list[str], target_world: Floats, offset: tuple[float, float, float]
) -> rrb.Spatial3DView:
    """Return a 3D view of the world.

    Args:
        name: Title of the view.
        contents: Entities to show, in Rerun's query language.
        target_world: (3,) point on the table; the view looks at the point 10 cm above it [m].
        offset: Position of the viewer relative to the target [m].
    """
    eye = rrb.EyeControls3D(position=target_world + offset, look_target=target_world + np.array([0.0, 0.0, 0.1]))
    return rrb.Spatial3DView(
        origin="world",
        contents=contents,
        name=name,
        background=_BACKGROUND,
        line_grid=False,
        eye_controls=eye,
    )
