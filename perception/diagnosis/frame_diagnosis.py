"""The diagnosis of a frame: facts, and likely causes of lost parts."""

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.boundary import BoundaryCloud, BoundarySettings, extract_boundary
from perception.depth_edges import depth_std, sampled_rows
from perception.diagnosis.depth_causes import noise_cause, sparse_cause
from perception.diagnosis.geometry_causes import geometry_causes
from perception.diagnosis.report import Cause, FrameReport, PoseCounts
from perception.diagnosis.samples import DepthSamples, grid_step
from perception.diagnosis.setup import Setup
from perception.frame import Frame, Workspace, bin_region
from perception.part import PartModel
from perception.thickness import part_boundary, part_thickness

FEWEST_PIXELS = 70  # length of a part in the image below which poses get worse [px]
LEAST_NOISES = 2.0  # thickness of a part in standard deviations of the depth under which it does not stand out
SPLITTING_PIXELS = 45  # length below which the segmentation splits parts [px]
_NOISE_ROWS = 8  # every such row of the bin's region tells the noise
_IN_VIEW = 0.9  # share of the bin's image in the frame below which that is said
_REGION_SAMPLES = 16_384  # number of pixels of the bin's region that grey levels and the median depth are taken from
_DARK, _BRIGHT = 40, 254  # grey levels: Canny's strong threshold, and a saturated pixel
_DARK_QUANTILE = 0.99  # quantile of the grey levels that reaches the threshold where there are edges
_SATURATED = 0.25  # share of saturated pixels from which contours are lost
_FLOOR_SHARE = 0.4  # share of the groups whose best hypotheses the floor rejected from which its height is suspected
_BELOW_FLOOR, _BELOW_FLOOR_SHARE = 0.005, 0.05  # least depth below the floor, in metres and as a share of d_max
_FLOOR_GROUPS = 3  # number of such groups from which it is; with fewer, the floor itself is in view


def diagnose(
    frame: Frame,
    workspace: Workspace,
    part: PartModel,
    boundary: BoundaryCloud | None = None,
    poses: PoseCounts | None = None,
) -> FrameReport:
    """Return the facts of a frame and the likely causes of lost parts; none for a good frame.

    A setup that is wrong in one way is often wrong in another one, too. Causes are looked for in the setup as it would
    be with the causes before them settled.

    Args:
        frame: Frame of the camera.
        workspace: Pose and size of the bin, as they are believed.
        part: Part that is searched for.
        boundary: Boundary points of the frame; extracted if None.
        poses: What became of the groups in the pose estimation; None if there was none.

    Note:
        Takes 2 to 5 ms for a frame of 1280 x 960 pixels, and as long as
        :func:`~perception.boundary.extract_boundary` more if the boundary is not given.
    """
    if boundary is None:
        boundary = extract_boundary(frame, workspace, part_boundary(part))
    samples = DepthSamples.of(frame)
    u0, v0, u1, v1 = bin_region(
        workspace, frame.K, frame.T_world_cam, samples.size, margin=0.0, headroom=BoundarySettings().headroom
    ).tolist()
    whole = frame.depth[v0:v1, u0:u1]
    step = grid_step(whole, _REGION_SAMPLES)
    depth, grey = whole[::step, ::step], frame.grey[v0:v1:step, u0:u1:step]
    found = cv2.countNonZero(whole) if whole.size else 0
    causes, setup = geometry_causes(samples, Setup.of(frame, workspace), poses is not None and poses.found > 0)
    sound = not causes
    if samples.missing is not None:
        causes.append(_missing_depth(samples))
    if sound:
        causes += sparse_cause(whole, poses)
    if boundary.source != "depth" or (frame.grey.any() and not frame.has_grey):  # without any, nothing is exposed
        causes += _exposure(grey if grey.size else frame.grey[::8, ::8])
    measured = depth[samples.measured(depth)]
    measured = measured if len(measured) else samples.depth[samples.measured(samples.depth)]
    pixels = _part_pixels(setup, part, measured)
    causes += _thickness(part, whole, setup.scale) + _resolution(pixels, len(boundary))
    if sound:
        causes += noise_cause(whole, setup.scale, part.d_max, poses)
    view = 1.0
    if sound:
        fit = setup.fit(samples)
        view = fit.view
        causes += _view(view) + _floor(part, fit.low, poses)
    return FrameReport(
        pixels=whole.size,
        depth_share=found / max(whole.size, 1),
        median_depth=float(np.median(depth[depth > 0])) if np.any(depth > 0) else None,
        boundary_points=len(boundary),
        outside=boundary.outside,
        part_pixels=pixels,
        poses=poses,
        causes=tuple(causes),
        in_view=view,
        boundary_source=boundary.source,
    )


def _missing_depth(samples: DepthSamples) -> Cause:
    text = (
        f"{100 * samples.missing_share:.1f} % of the pixels have exactly the depth {samples.missing:.6g} m, far from "
        "all others: it seems to stand for no measurement; set these pixels to 0"
    )
    return Cause(name="missing_depth", text=text)


def _exposure(grey: NDArray[np.uint8]) -> list[Cause]:
    """Suspect the exposure if no edge can reach the detector's threshold, or much is saturated."""
    bright = float(np.quantile(grey, _DARK_QUANTILE))
    if bright < _DARK:
        text = (
            f"99 % of the bin's image is darker than grey level {bright:.0f} of 255: the image is underexposed; edges "
            f"need steps of {_DARK} levels, so expose longer, or scale the grey levels up"
        )
        return [Cause(name="underexposed", text=text)]
    saturated = float(np.mean(grey >= _BRIGHT))
    if saturated >= _SATURATED:
        text = (
            f"{100 * saturated:.0f} % of the bin's image is saturated: the image is overexposed and contours are lost; "
            "expose it shorter"
        )
        return [Cause(name="overexposed", text=text)]
    return []


def _part_pixels(setup: Setup, part: PartModel, depths: NDArray[np.float32]) -> float | None:
    """Return the expected length of a part in the image [px] at the median of (N,) depths; None without any."""
    if len(depths) == 0:
        return None
    focal = float(np.sqrt(setup.K[0, 0] * setup.K[1, 1]))
    return focal * part.d_max / (float(np.median(depths)) * setup.scale)


def _view(view: float) -> list[Cause]:
    """Suspect the camera's place if a part of the bin lies outside the image."""
    if view >= _IN_VIEW:
        return []
    text = (
        f"only {100 * view:.0f} % of the bin's image lies within the frame: parts beside it are not found, and those "
        "that it cuts are found badly; move the camera, take a shorter lens, or check T_world_bin and K "
        "(--bin-pose and --calibration)"
    )
    return [Cause(name="partly_outside", text=text)]


def _thickness(part: PartModel, depth: NDArray[np.float32], scale: float) -> list[Cause]:
    """Suspect the part's thickness if the noise of the depth is not much less.

    Args:
        part: Part that is searched for.
        depth: (H, W) depth.
        scale: Length of one unit of it [m].
    """
    thickness, noise = part_thickness(part), depth_std(sampled_rows(depth, _NOISE_ROWS)) * scale
    if thickness >= LEAST_NOISES * noise:
        return []
    text = (
        f"the part is {1000 * thickness:.3g} mm thick, and the noise of the depth is {1000 * noise:.2g} mm: parts that "
        "lie flat on the floor hardly stand out from it; average several frames, or move the camera nearer"
    )
    return [Cause(name="thin_part", text=text)]


def _resolution(pixels: float | None, points: int) -> list[Cause]:
    """Suspect the part's size in the image.

    Args:
        pixels: Expected length of a part in the image [px]; None without depth.
        points: Number of boundary points. The outline of a part has at least twice as many as it is long; with fewer
            than its length there is no part in the bin.
    """
    causes = []
    if pixels is not None and pixels < min(FEWEST_PIXELS, points):
        splits = f" (under {SPLITTING_PIXELS} the segmentation splits parts)" if pixels < SPLITTING_PIXELS else ""
        text = (
            f"a part is only about {pixels:.0f} pixels long, {FEWEST_PIXELS} are needed{splits}: move the camera "
            "nearer, or take a longer lens or a higher resolution"
        )
        causes.append(Cause(name="few_pixels", text=text))
    return causes


def _floor(part: PartModel, low: float, poses: PoseCounts | None) -> list[Cause]:
    """Suspect the height of the bin if much is measured below its floor, or the floor rejected many poses.

    Args:
        part: Part that is searched for.
        low: Height over the floor below which a quarter of the measurements lie [m].
        poses: What became of the groups in the pose estimation; None if there was none.
    """
    signs = []
    if low < -max(_BELOW_FLOOR, _BELOW_FLOOR_SHARE * part.d_max):
        signs.append(f"a quarter of what is measured in the bin lies {-1000 * low:.0f} mm or more below its floor")
    if poses is not None and poses.by_floor >= max(_FLOOR_GROUPS, _FLOOR_SHARE * poses.groups, poses.found):
        signs.append(f"the floor rejected the best poses of {poses.by_floor} of {poses.groups} groups")
    if not signs:
        return []
    text = (
        f"{', and '.join(signs)}: the bin seems to stand lower than T_world_bin says, tilted or elsewhere; "
        "measure its pose again"
    )
    return [Cause(name="floor_height", text=text)]
