"""What a recording shows and how it opens: the cell, a frame and what was seen in it, a grasp, the motion.

Needs Rerun, which comes with the extra ``viz``: imported only where something is recorded. Everything lies below
``world`` in the world frame [m]; the timelines are ``time``, simulated [s], and ``pick``, the number of the decision.
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
from policies.report.recording_motion import Motion, drawn, pack

if TYPE_CHECKING:  # it brings the pose estimator's kernels, which the oracle does without
    from perception.pipeline import Perception

Vector = tuple[float, float, float]
CLOUD_POINTS = 60_000  # of a frame at most, on a regular grid of its pixels
JPEG_QUALITY = 80
_POSE, _TRUE, _NO_GROUP = (80, 190, 120), (160, 164, 172), (110, 110, 110)
_BACKGROUND = (38, 40, 46)
_JAW, _APPROACH = (255, 140, 40), (235, 235, 235)
_FINGER, _PAD, _REACH = 0.04, 0.011, 0.10  # a finger's drawn length, half a pad's width, the drawn approach [m]
_NORMAL_STEPS = 20  # corners of a vertex share a normal up to a twentieth


class SceneLog:
    """Writes what happens in a cell into a Rerun file, at the times it is told."""

    def __init__(self, path: Path, env: BinPickEnv) -> None:
        """Open ``path`` and write what stays as it is; about a second, most of it for the robot's meshes."""
        self._path, self._env = path, env
        self._stream = rr.RecordingStream("binpick")
        self._stream.save(path, default_blueprint=_blueprint(env))
        self._stream.send_recording_name(f"a bin of {env.part.model.name}")
        self._stream.set_log_time_enabled(False)  # wall clock tells nothing here
        self._motion = Motion(env.simulation)
        self._log_shapes()
        for entity, name in (("gripper/closed", "closed"), ("gripper/target", "target"), ("force", "force [N]")):
            self._stream.log(entity, rr.SeriesLines(names=name), static=True)

    def _log_shapes(self) -> None:
        """Write every visible shape once: of robot and cell, and the part's for true and for seen poses."""
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
        """Write a body's visible geoms, each once, and its pose if it never moves."""
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
        """Remember where everything is now."""
        self._motion.add()

    def frame(self, pick: int) -> None:
        """Write the last frame, what was seen in it and where everything is, as what decision ``pick`` is made on."""
        env, stream = self._env, self._stream
        self._at(env.simulation.time, pick)
        _log_camera(stream, env.frame)
        stream.log("world/seen/cloud", _cloud(env.frame))
        if env.observed.perception is not None:
            stream.log("world/seen/segments", _segments(env.frame, env.observed.perception))
        T_world: Floats = np.array([each.T_world_part for each in env.candidates]).reshape(-1, 4, 4)
        translations, quaternions, scales = drawn(pack(T_world))
        poses = rr.InstancePoses3D(translations=translations, quaternions=quaternions, scales=scales)
        stream.log("world/seen/poses", poses)
        labels = [f"{each.score:.2f}" for each in env.candidates]
        centres = np.array([each.centre_world for each in env.candidates]).reshape(-1, 3)
        stream.log("world/seen/scores", rr.Points3D(centres, labels=labels, radii=0.001, colors=_POSE))
        stream.log("world/grasp", rr.LineStrips3D([]))  # the last one's is over
        self._motion.log_now(stream)

    def decision(self, pick: int, start: float, result: PickResult) -> None:
        """Write decision ``pick``, made at ``start`` [s] and carried out by now."""
        stream = self._stream
        self._at(start, pick)
        stream.log("world/grasp", jaw_lines(result.grasp) if result.grasp is not None else rr.LineStrips3D([]))
        self._at(self._env.simulation.time, pick)
        if result.outcome is None:
            text, level = f"pick {pick}: nothing tried, {result.abstention}", rr.TextLogLevel.WARN
        else:
            text, level = f"pick {pick}: {result.outcome}", rr.TextLogLevel.INFO
            level = level if result.success else rr.TextLogLevel.ERROR
        stream.log("log", rr.TextLog(text.replace("_", " "), level=level))

    def close(self) -> None:
        """Write the motion and close the file.

        Raises:
            OSError: The file is not whole.
        """
        self._motion.send(self._stream)
        self._stream.flush()
        self._stream.disconnect()
        if not is_whole(self._path):
            raise OSError("the recording could not be written to its end; is the disk full?")

    def abandon(self) -> None:
        """Close the file as it is."""
        self._stream.disconnect()

    def _at(self, time: float, pick: int) -> None:
        self._stream.set_time("time", duration=time)
        self._stream.set_time("pick", sequence=pick)


def is_whole(path: Path) -> bool:
    """Return whether a recording has its end: Rerun says nothing of a disk that was full."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what is missing
            RrdReader(path).store()
    except (OSError, RuntimeError, ValueError):
        return False
    return True


def geom_mesh(model: mujoco.MjModel, geom: int) -> rr.Mesh3D:
    """Return a mesh or box geom in its body's frame, in its colour."""
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
    """Return a mesh with normals, without which a viewer shades nothing; vertices are split along sharp edges only.

    Args:
        vertices: (V, 3) [m]; several at one place count as one.
        faces: (T, 3).
        colour: RGB.
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


def jaw_lines(grasp: GraspCandidate) -> rr.LineStrips3D:
    """Return the jaw as it opens (thin) and as it closes (thick), and the last 10 cm of its way there."""
    strips: list[list[Vector]] = [[(0, 0, -_REACH), (0, 0, -_FINGER)]]
    radii, colours = [0.0004], [_APPROACH]
    for gap, radius in ((grasp.opening, 0.0004), (grasp.width, 0.001)):
        half = gap / 2
        strips.append([(0, -half, 0), (0, -half, -_FINGER), (0, half, -_FINGER), (0, half, 0)])
        strips += [[(-_PAD, side, 0), (_PAD, side, 0)] for side in (-half, half)]
        radii += 3 * [radius]
        colours += 3 * [_JAW]
    lines = [transform_points(grasp.T_world_grasp, np.array(strip, np.float64)) for strip in strips]
    return rr.LineStrips3D(lines, radii=radii, colors=colours)


def _cloud(frame: Frame) -> rr.Points3D:
    """Return what the depth camera saw, thinned, in the image's grey."""
    step = max(1, int(np.ceil(np.sqrt(frame.valid.sum() / CLOUD_POINTS))))
    seen = frame.valid[::step, ::step]
    points_cam = deproject_depth(frame.K, frame.depth)[::step, ::step][seen]
    grey = np.repeat(frame.grey[::step, ::step][seen][:, None], 3, axis=1)
    pitch = step * float(np.median(points_cam[:, 2])) / float(frame.K[0, 0]) if len(points_cam) else 0.0
    return rr.Points3D(transform_points(frame.T_world_cam, points_cam), colors=grey, radii=0.6 * pitch)


def _segments(frame: Frame, seen: "Perception") -> rr.Points3D:
    """Return the boundary points in the colours of their groups."""
    labels = labels_of(seen.segments, len(seen.boundary))
    colours = np.vstack([part_colours(len(seen.segments))[:, ::-1], [_NO_GROUP]])[labels]
    points_world = transform_points(frame.T_world_cam, seen.boundary.points_cam)
    return rr.Points3D(points_world, colors=colours, radii=rr.Radius.ui_points(1.5))


def _log_camera(stream: rr.RecordingStream, frame: Frame) -> None:
    height, width = frame.grey.shape
    T = frame.T_world_cam
    pinhole = rr.Pinhole(image_from_camera=frame.K, width=width, height=height, image_plane_distance=0.08)
    stream.log("world/seen/camera", pinhole, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
    stream.log("world/seen/camera/image", rr.Image(frame.grey, color_model="L").compress(JPEG_QUALITY))


def _blueprint(env: BinPickEnv) -> rrb.Blueprint:
    """Return the views: what is, what the robot sees of it, its camera's image, jaw and force, the outcomes."""
    bin_world = env.workspace.T_world_bin[:3, 3]
    cell = _room("The cell", ["$origin/**", "- $origin/seen/**"], bin_world, (0.95, -0.95, 0.75))
    seen_contents = ["$origin/seen/**", "$origin/grasp", f"$origin/cell/{BIN_BODY}/**"]
    seen = _room("What the robot sees", seen_contents, bin_world, (0.22, -0.3, 0.55))
    drawn_on_image = ["$origin/**", "/world/seen/segments", "/world/grasp"]
    below = rrb.Horizontal(
        rrb.Spatial2DView(name="Camera", origin="world/seen/camera", contents=drawn_on_image),
        rrb.TimeSeriesView(name="Jaw, 0 open to 1 closed", origin="gripper"),
        rrb.TimeSeriesView(name="Contact force on the robot [N]", origin="force"),
        rrb.TextLogView(name="Outcomes", origin="log"),
    )
    time = rrb.TimePanel(timeline="time", state="collapsed")
    return rrb.Blueprint(rrb.Vertical(rrb.Horizontal(cell, seen), below, row_shares=[2, 1]), time, collapse_panels=True)


def _room(
    name: str, contents: list[str], target_world: Floats, offset: tuple[float, float, float]
) -> rrb.Spatial3DView:
    """Return a view of the world that looks at 10 cm over (3,) ``target_world`` from ``offset`` beside it [m]."""
    eye = rrb.EyeControls3D(position=target_world + offset, look_target=target_world + np.array([0.0, 0.0, 0.1]))
    return rrb.Spatial3DView(
        origin="world",
        contents=contents,
        name=name,
        background=_BACKGROUND,
        line_grid=False,
        eye_controls=eye,
    )
