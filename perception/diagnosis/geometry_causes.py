"""Wrong units, camera matrices and poses: an assumption is suspected where another one explains the frame better."""

from dataclasses import replace

import numpy as np

from perception.diagnosis.report import Cause, CauseName
from perception.diagnosis.samples import BoxFit, DepthSamples
from perception.diagnosis.setup import Setup
from perception.diagnosis.size_unit import size_unit_cause
from perception.diagnosis.swapped_centre import swapped_centre
from perception.geometry import Floats, invert_transform

_FARTHEST = 50.0  # median depth [m] that no camera over a bin measures; 50 mm is less than the nearest ones see
_NEAREST = 0.01  # median depth [m] below which no camera sees a bin
# Factors from depth in a wrong unit to metres, the likeliest first.
_SMALLER = {
    1e-3: "be in millimetres",
    1e-4: "be in tenths of a millimetre",
    1e-2: "be in centimetres",
    1e-6: "be in micrometres",
}
_LARGER = {1e3: "have been divided by 1000 once too often", 1e2: "have been divided by 100 too often"}
_IMPERIAL = {0.0254: "be in inches", 0.3048: "be in feet"}  # values that might be metres, too
_OFF_CENTRE = 1.25  # ratio of the principal point and the middle of the image from which K is another image's
_FITS = 0.5  # share of the measurements that lie in the box if the bin is where it is said to be
_MISFIT = 0.3  # share below which it is not
_FEWEST_MEASURED = 0.05  # share of the pixels of the bin below which nothing can be said of its pose
_LEVELLED = 1.5  # factor by which more pairs of measurements are at one height if depth is a distance: then it is
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # from OpenGL's camera axes (y up, z back) to OpenCV's, and back
_OVER = np.diag([1.0, -1.0, -1.0, 1.0])  # turns a bin over


def geometry_causes(samples: DepthSamples, setup: Setup, poses_found: bool) -> tuple[list[Cause], Setup]:
    """Return the causes that units, camera matrix and poses give, and the setup as it should be.

    Args:
        samples: Depth measurements of the frame.
        setup: Camera and bin as they were given.
        poses_found: Whether poses were verified: then neither scale nor camera matrix can be far off.
    """
    causes: list[Cause] = []
    depths = samples.depth[samples.measured(samples.depth)]
    if len(depths) == 0:
        return [_no_depth("no pixel")], setup
    median = float(np.median(depths))
    if not _NEAREST <= median < _FARTHEST:
        setup, text = _depth_unit(samples, setup, median)
        causes.append(Cause(name="depth_unit", text=text))
    size = size_unit_cause(samples, setup)
    if size is not None:
        causes.append(size[0])
        setup = replace(setup, inner_size=setup.inner_size * size[1])
    if (swapped := swapped_centre(samples, setup)) is not None:  # it leaves good poses, in the wrong place
        causes.append(swapped[0])
        setup = swapped[1]
    if not poses_found:
        for check in (_imperial, _camera_matrix, _bin_turned, _poses):
            found = check(samples, setup)
            if found is not None:
                causes.append(found[0])
                setup = found[1]
    if not causes:
        causes += _range(samples, setup)
    return causes, setup


def _depth_unit(samples: DepthSamples, setup: Setup, median: float) -> tuple[Setup, str]:
    """Return the setup with the unit of depth by which the measurements fill the bin best, and what is said of it.

    It is the millimetre, or one thousandth of what was taken, where none makes them fill it.
    """
    scales = _LARGER if median < _NEAREST else _SMALLER
    setups = [replace(setup, scale=scale) for scale in scales]
    fits = [each.fit(samples).inside for each in setups]
    best = int(np.argmax(fits)) if max(fits) >= _FITS else 0
    scale, seems = list(scales.items())[best]
    return setups[best], _unit_text(median, scale, seems)


def _imperial(samples: DepthSamples, setup: Setup) -> tuple[Cause, Setup] | None:
    """Suspect inches or feet if what is measured where the bin should be fills its box only in one of them."""
    if setup.scale != 1.0 or setup.fit(samples).inside >= _MISFIT:
        return None
    for scale, seems in _IMPERIAL.items():
        other = replace(setup, scale=scale)
        if other.fit(samples).inside >= _FITS:
            median = float(np.median(samples.depth[samples.measured(samples.depth)]))
            return Cause(name="depth_unit", text=_unit_text(median, scale, seems)), other
    return None


def _unit_text(median: float, scale: float, seems: str) -> str:
    return (
        f"the median depth is {median:.4g} m: the depth seems to {seems}; multiply it by {scale:g} "
        f"(--depth-scale on the command line, {scale:g} of what it is)"
    )


def _range(samples: DepthSamples, setup: Setup) -> list[Cause]:
    """Suspect distances from the camera's centre in place of depths if they make surfaces level that are not."""
    by_axis = samples.level(setup.K, setup.T_cam_bin, setup.scale)
    by_ray = samples.level(setup.K, setup.T_cam_bin, setup.scale, along_rays=True)
    if by_ray <= _LEVELLED * by_axis:
        return []
    text = (
        f"level surfaces are curved in the depth, and {by_ray / by_axis:.1f} times as level if it is taken for the "
        "distance from the camera's centre: it seems to be that, and not the depth along the camera's axis; divide it "
        "by sqrt(1 + ((u - cx) / fx)^2 + ((v - cy) / fy)^2) (--depth-along ray on the command line)"
    )
    return [Cause(name="depth_range", text=text)]


def _no_depth(which: str) -> Cause:
    text = f"{which} has a depth: check exposure and range of the depth camera, and what shines or absorbs light"
    return Cause(name="no_depth", text=text)


def _camera_matrix(samples: DepthSamples, setup: Setup) -> tuple[Cause, Setup] | None:
    """Suspect K if its principal point is the middle of a larger or smaller image."""
    width, height = samples.size
    across, down = (2 * setup.K[0, 2] + 1) / width, (2 * setup.K[1, 2] + 1) / height
    larger, smaller = min(across, down) >= _OFF_CENTRE, max(across, down) <= 1 / _OFF_CENTRE
    if not (larger or smaller):
        return None
    # Keeping the upper left of a larger image moves the principal point likewise; the bin is then in view.
    shrink = np.array([1 / across, 1 / down, 1.0])
    other = replace(setup, K=setup.K * shrink[:, None])
    if larger and setup.fit(samples).view >= min(0.9, other.fit(samples).view):
        return None
    text = (
        f"the principal point ({setup.K[0, 2]:.0f}, {setup.K[1, 2]:.0f}) px is the middle of an image of about "
        f"{across * width:.0f} x {down * height:.0f} px, but this one has {width} x {height}: K seems to be that of "
        f"another resolution; multiply its first row by {1 / across:.2g} and its second by {1 / down:.2g}"
    )
    return Cause(name="camera_matrix", text=text), other


def _bin_turned(samples: DepthSamples, setup: Setup) -> tuple[Cause, Setup] | None:
    """Suspect the bin's pose if its z axis points away from the camera, and the bin is there once it is turned over."""
    if setup.T_cam_bin[2, 2] <= 0:
        return None
    other = replace(setup, T_world_bin=setup.T_world_bin @ _OVER)
    fit = other.fit(samples)
    if min(fit.inside, fit.view) < _FITS:
        return None
    text = (
        "the z axis of T_world_bin points away from the camera, but must point up, out of the bin: use "
        "T_world_bin @ diag(1, -1, -1, 1) (--bin-pose)"
    )
    return Cause(name="bin_pose", text=text), other


def _poses(samples: DepthSamples, setup: Setup) -> tuple[Cause, Setup] | None:
    """Suspect the poses of camera and bin if what is measured where the bin should be is not in its box."""
    fit = setup.fit(samples)
    unseen = fit.view >= _FITS and fit.measured < _FEWEST_MEASURED
    if fit.inside >= _MISFIT and not unseen:
        return None
    corrected = _camera_pose(samples, setup)
    if corrected is not None:
        return corrected
    return _no_depth("hardly any pixel of the bin") if unseen else _bin_pose(fit, setup), setup


def _camera_pose(samples: DepthSamples, setup: Setup) -> tuple[Cause, Setup] | None:
    """Suspect the camera's pose if the bin would be where it is said to be with a usual mistake undone."""
    inverse = invert_transform(setup.T_world_cam)
    opengl = "T_world_cam seems to have OpenGL's camera axes (y up, z back)"
    inverted = "T_world_cam seems to be its inverse, which maps the world to the camera"
    others: list[tuple[CauseName, Floats, str]] = [
        ("camera_axes", setup.T_world_cam @ _OPENGL, f"{opengl}; use T_world_cam @ diag(1, -1, -1, 1) (--camera-pose)"),
        ("camera_inverted", inverse, f"{inverted}; invert it (--camera-pose)"),
        (
            "camera_inverted",
            inverse @ _OPENGL,
            f"{inverted}, with OpenGL's camera axes; use inv(T_world_cam) @ diag(1, -1, -1, 1) (--camera-pose)",
        ),
    ]
    fits = [replace(setup, T_world_cam=T).fit(samples) for _, T, _ in others]
    best = max(range(len(others)), key=lambda k: fits[k].inside * fits[k].view)
    if min(fits[best].inside, fits[best].view) < _FITS:
        return None
    name, T_world_cam, advice = others[best]
    text = (
        f"the frame shows no bin where it should be, but {100 * fits[best].inside:.0f} % of what is measured there "
        f"lies in its box if the camera's pose is corrected: {advice}"
    )
    return Cause(name=name, text=text), replace(setup, T_world_cam=T_world_cam)


def _bin_pose(fit: BoxFit, setup: Setup) -> Cause:
    """Return the cause where no usual mistake explains that the bin is elsewhere."""
    where = f"only {100 * fit.inside:.0f} % of what is measured there is in its box"
    where = "the camera looks elsewhere" if fit.view == 0 else where
    text = (
        f"the frame shows no bin where it should be: {where}; check T_world_bin and T_world_cam (--bin-pose and "
        "--camera-pose)"
    )
    if _is_identity(setup.T_world_cam):
        text += "; T_world_cam is the identity: if the bin's pose is that in a robot's world, give the camera's, too"
    if _is_identity(setup.T_world_bin):
        text = (
            f"the bin stands at the origin of the world (T_world_bin is the identity), but {where}: T_world_bin is the "
            "pose of the middle of the inner floor, z up"
        )
    return Cause(name="bin_pose", text=text)


def _is_identity(T: Floats) -> bool:
    return bool(np.allclose(T, np.eye(4), rtol=0, atol=1e-6))
