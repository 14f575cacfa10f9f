"""Frames from the files of real cameras."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from perception.capture.calibration import Calibration, require_pose
from perception.capture.calibration_files import read_calibration
from perception.capture.cloud_frame import images_of_cloud
from perception.capture.content import Content, load_content
from perception.capture.damage import decoding, require_file
from perception.capture.frame_edits import crop_frame, turn_frame
from perception.capture.images import grey_image, metres, read_raw
from perception.capture.options import ReadOptions, ReadReport
from perception.capture.recordings import is_recording, recording_content, require_rosbags
from perception.capture.undistortion import undistort
from perception.frame import Frame
from perception.geometry import Floats, as_floats, ray_lengths

PathLike = str | Path
Matrix = NDArray[np.floating] | Sequence[Sequence[float]]
SATURATED = 65535  # largest value of 16 bits, which many cameras store where they measured nothing
FAR = 20.0  # median depth beyond which the unit is probably wrong; no camera over a bin measures it [m]
_log = logging.getLogger(__name__)


def read_frame(
    path: PathLike,
    *,
    grey: PathLike | None = None,
    calibration: Calibration | PathLike | Matrix | None = None,
    T_world_cam: Matrix | None = None,
    options: ReadOptions | None = None,
) -> Frame:
    """Read one frame of a real camera from a depth image or a point cloud.

    Without a grey image or a coloured cloud, the frame's grey image is zeros, and its boundary points will be those of
    the depth. What the reading found is logged; :func:`read_frame_with_report` returns it.

    Args:
        path: Depth image (16-bit PNG or TIFF, EXR, NPY), cloud (PCD, PLY, NPZ, or an image of three floating-point
            channels), or a frame that :func:`write_frame` wrote.
        grey: Grey or colour image, registered to the depth.
        calibration: Calibration, a file of one, or the (3, 3) camera matrix; None if the file holds it, or if it is
            recovered from an organised cloud.
        T_world_cam: (4, 4) camera pose, OpenCV axes; None for the one that the files state, otherwise the identity.
        options: What the files do not say themselves; the defaults of :class:`ReadOptions` if left out.

    Raises:
        FileNotFoundError: A file does not exist.
        IsADirectoryError: A file is a folder, and no recording.
        ValueError: A file is damaged, or the files do not fit together; the message says what to do.
    """
    frame, report = read_frame_with_report(
        path, grey=grey, calibration=calibration, T_world_cam=T_world_cam, options=options
    )
    _log.info("%s: %s", Path(path).name, report)
    return frame


def read_frame_with_report(
    path: PathLike,
    *,
    grey: PathLike | None = None,
    calibration: Calibration | PathLike | Matrix | None = None,
    T_world_cam: Matrix | None = None,
    options: ReadOptions | None = None,
) -> tuple[Frame, ReadReport]:
    """Read one frame of a real camera, and say what the reading found and did.

    Args:
        path: File of :func:`read_frame`.
        grey: Grey or colour image, registered to the depth.
        calibration: Calibration, a file of one, or the (3, 3) camera matrix.
        T_world_cam: (4, 4) camera pose, OpenCV axes.
        options: What the files do not say themselves.

    Raises:
        FileNotFoundError: A file does not exist.
        IsADirectoryError: A file is a folder, and no recording.
        ValueError: A file is damaged, or the files do not fit together; the message says what to do.
    """
    path, options = Path(path), options or ReadOptions()
    content = _recorded(path, options, calibrated=calibration is None) if is_recording(path) else load_content(path)
    options.require_use(cloud=content.cloud is not None, recording=is_recording(path))
    if options.grid is not None and content.cloud is not None:
        content = replace(content, cloud=content.cloud.in_grid(*options.grid))
    if grey is not None:
        require_file(Path(grey), "grey image")
        with decoding(Path(grey)):
            image = grey_image(read_raw(Path(grey)), f"the grey image {Path(grey).name}")
        content = replace(content, grey=image)
    camera = _calibration(calibration, content, options, path)
    pose = None if T_world_cam is None else require_pose("T_world_cam", T_world_cam)
    return frame_of_content(content, camera, options, T_world_cam=pose, name=path.name)


def frame_of_content(
    content: Content,
    camera: Calibration | None,
    options: ReadOptions,
    *,
    T_world_cam: Floats | None = None,
    name: str = "the camera",
) -> tuple[Frame, ReadReport]:
    """Return the frame of a depth image or a cloud, and what was found and done.

    Args:
        content: Depth image or cloud, perhaps with a grey image.
        camera: Calibration; None if it is recovered from an organised cloud.
        options: Unit, axes, crop and turn.
        T_world_cam: (4, 4) camera pose; None for that of calibration or cloud, otherwise the identity.
        name: Name of the source, for messages.

    Raises:
        ValueError: What is given does not fit together; the message says what to do.
    """
    frame, report = (
        _from_cloud(content, camera, options)
        if content.cloud is not None
        else _from_depth(content, camera, options, name)
    )
    if T_world_cam is None and (camera is None or camera.T_world_cam is None):
        T_world_cam = content.T_world_cam
    if T_world_cam is not None:
        frame = replace(frame, T_world_cam=T_world_cam)
    if options.crop is not None:
        frame = crop_frame(frame, *options.crop)
    frame = turn_frame(frame, options.quarter_turns)
    report = replace(report, measured_fraction=float(np.mean(frame.valid)))
    if frame.valid.any() and (middle := float(np.median(frame.depth[frame.valid]))) > FAR:
        _log.warning(
            "%s: the median depth is %.0f m: is scale right (0.001 for millimetres)? It is --depth-scale on the "
            "command line",
            name,
            middle,
        )
    return frame, report


def _recorded(path: Path, options: ReadOptions, *, calibrated: bool) -> Content:
    require_rosbags(path)
    if not path.exists():
        raise FileNotFoundError(f"there is no recording {path}")
    with decoding(path):
        return recording_content(
            path,
            options.index,
            options.topic,
            options.grey_topic,
            calibrated=calibrated,
            scaled=options.scale is None,
        )


def _calibration(
    given: Calibration | PathLike | Matrix | None, content: Content, options: ReadOptions, path: Path
) -> Calibration | None:
    """Return the calibration, fitted to the size of the image, with the unit that the content states if it has none.

    None stands for no calibration.
    """
    grid = content.depth if content.depth is not None else content.cloud.points if content.cloud is not None else None
    size = None if grid is None or grid.ndim < 2 or grid.shape[0] == 1 else (grid.shape[1], grid.shape[0])
    if isinstance(given, str | Path):
        number = int(path.stem) if path.stem.isdigit() else None
        image_id = number if options.image_id is None else options.image_id
        camera: Calibration | None = read_calibration(given, image_id=image_id, size=size)
    elif given is None:
        camera = content.calibration
    else:
        camera = given if isinstance(given, Calibration) else Calibration(K=as_floats("K", given))
    if camera is not None and camera.depth_scale is None:
        camera = replace(camera, depth_scale=content.depth_scale)
    if camera is None or size is None or (content.cloud is not None and options.project):
        return camera
    if options.fit == "scale":
        return camera.scaled(size)
    camera.require_size(size)
    return camera


def _from_depth(
    content: Content, camera: Calibration | None, options: ReadOptions, name: str
) -> tuple[Frame, ReadReport]:
    if camera is None:
        raise ValueError(
            f"the depth image {name} needs a calibration: pass calibration= (--calibration on the command line) as a "
            "file (RealSense, Azure Kinect, BOP, OpenCV, ROS), a Calibration, or the (3, 3) camera matrix [px]"
        )
    raw = np.asarray(content.depth)
    missing = options.missing
    if missing is None:
        missing = (0.0,) if raw.dtype.kind == "f" else (0.0, float(SATURATED))
    # The unit that a calibration states is the one of integers; floating-point images are in metres.
    stated = None if raw.dtype.kind == "f" else camera.depth_scale
    depth = metres(raw, stated if options.scale is None else options.scale, missing, name)
    _require_registered(content.grey, depth.shape)
    grey, depth = undistort(content.grey, depth, camera)
    if options.depth_along == "ray":
        height, width = depth.shape
        depth = (depth / ray_lengths(camera.K, np.arange(width), np.arange(height))).astype(np.float32)
    frame = Frame(
        grey=_or_zeros(grey, depth.shape),
        depth=depth,
        K=camera.K,
        T_world_cam=np.eye(4) if camera.T_world_cam is None else camera.T_world_cam,
    )
    return frame, ReadReport(
        source="depth image",
        grey="image" if frame.grey.any() else "none",
        undistorted=bool(camera.distortion.any()),
    )


def _from_cloud(content: Content, camera: Calibration | None, options: ReadOptions) -> tuple[Frame, ReadReport]:
    if content.cloud is None:
        raise ValueError("a cloud is required")
    scale = 1.0 if options.scale is None else options.scale
    images = images_of_cloud(content.cloud, camera, scale=scale, axes=options.axes, project=options.project)
    projected = images.residual is None
    _require_registered(content.grey, images.depth.shape)
    grey, undistorted = content.grey, False
    if grey is not None and camera is not None and projected:  # the points are where a pinhole camera sees them
        grey, _ = undistort(grey, images.depth, camera)
        undistorted = bool(camera.distortion.any())
    if grey is None:
        grey = images.grey
    poses = (camera.T_world_cam if camera is not None else None, images.T_world_cam, np.eye(4))
    frame = Frame(
        grey=_or_zeros(grey, images.depth.shape),
        depth=images.depth,
        K=images.K,
        T_world_cam=next(pose for pose in poses if pose is not None),
    )
    return frame, ReadReport(
        source="projected cloud" if projected else "organised cloud",
        grey="none" if not frame.grey.any() else "cloud" if content.grey is None else "image",
        K_recovered=camera is None,
        K_residual=images.residual,
        undistorted=undistorted,
        unseen_points=images.unseen,
    )


def _or_zeros(grey: NDArray[np.uint8] | None, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return a grey image, or zeros for a camera that takes none."""
    return np.zeros(shape, np.uint8) if grey is None else grey


def _require_registered(grey: NDArray[np.uint8] | None, shape: tuple[int, ...]) -> None:
    if grey is not None and grey.shape != shape:
        raise ValueError(
            f"the grey image must be registered to the depth and have its size (H, W) = {shape}, got {grey.shape}: let "
            "the camera's driver align the images"
        )
