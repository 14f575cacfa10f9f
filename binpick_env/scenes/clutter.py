"""Visible fractions of the parts in a bin, and the three statistics of them that every evaluation prints."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from binpick_env.camera import _raster_kernels as _kernels
from binpick_env.camera.depth_camera import Capture
from binpick_env.camera.view import pixel_slopes
from perception.geometry import Floats, invert_transform, require_shape


@dataclass(frozen=True, kw_only=True)
class ClutterStats:
    """Statistics of the visible fractions of parts in one bin or several.

    Attributes:
        count: Number of parts.
        median: Median visible fraction; NaN without parts.
        below_half: Share of parts with a visible fraction under 0.5; NaN without parts.
        above_nine_tenths: Share of parts with a visible fraction over 0.9; NaN without parts.
    """

    count: int
    median: float
    below_half: float
    above_nine_tenths: float

    @classmethod
    def from_fractions(cls, fractions: Floats | Sequence[float]) -> "ClutterStats":
        """Compute the statistics of (N,) visible fractions, of one bin or of several bins together."""
        values = np.asarray(fractions, dtype=np.float64)
        require_shape("fractions", values, (None,))
        if len(values) == 0:
            return cls(count=0, median=np.nan, below_half=np.nan, above_nine_tenths=np.nan)
        return cls(
            count=len(values),
            median=float(np.median(values)),
            below_half=float(np.mean(values < 0.5)),
            above_nine_tenths=float(np.mean(values > 0.9)),
        )


def pooled_clutter(stats: Sequence[ClutterStats]) -> dict[str, float | None]:
    """Combine bins into one dict: mean of their medians, and the two shares and the number of all parts."""
    filled = [s for s in stats if s.count]
    parts = [s.count for s in filled]
    if not filled:
        return {"median": None, "below_half": None, "above_nine_tenths": None, "parts": 0}
    return {
        "median": float(np.mean([s.median for s in filled])),
        "below_half": float(np.average([s.below_half for s in filled], weights=parts)),
        "above_nine_tenths": float(np.average([s.above_nine_tenths for s in filled], weights=parts)),
        "parts": sum(parts),
    }


def visible_fractions(capture: Capture, mesh: trimesh.Trimesh, T_world_parts: Floats) -> Floats:
    """Compute each part's visible fraction: visible pixels / pixels of the part rendered alone.

    Args:
        capture: Capture in which part n has instance id n.
        mesh: Watertight mesh that all parts share, in the part frame [m].
        T_world_parts: (N, 4, 4) poses of the parts.

    Returns:
        (N,) visible fractions in [0, 1]; 0 for a part outside the image.

    Raises:
        ValueError: The capture shows an instance that has no pose.
    """
    require_shape("T_world_parts", T_world_parts, (None, 4, 4))
    count = len(T_world_parts)
    if capture.instance_ids.max(initial=-1) >= count:
        raise ValueError(f"the capture shows part {capture.instance_ids.max()}, but there are only {count} poses")
    seen = capture.instance_ids[capture.instance_ids >= 0]
    visible = np.bincount(seen, minlength=count)[:count]
    T_cam_parts = invert_transform(capture.T_world_cam) @ T_world_parts
    alone = silhouette_pixels(mesh, T_cam_parts, capture.frame.K, capture.instance_ids.shape, capture.region)
    # The simulation's meshes are single precision: a pixel on the outline may be visible, yet not in the silhouette.
    return np.minimum(visible / np.maximum(alone, 1), 1.0) * (alone > 0)


def silhouette_pixels(
    mesh: trimesh.Trimesh,
    T_cam_parts: Floats,
    K: Floats,
    size: tuple[int, ...],
    region: tuple[int, int, int, int] | None = None,
) -> NDArray[np.int64]:
    """Count the pixels of the mesh's silhouette at each pose, rendered alone.

    Args:
        mesh: Watertight mesh in the part frame [m].
        T_cam_parts: (N, 4, 4) poses of the part in the camera frame.
        K: (3, 3) camera matrix [px].
        size: Height and width of the image [px].
        region: Half-open rectangle ``(u0, v0, u1, v1)`` of pixels to count; the whole image by default.

    Returns:
        (N,) number of pixels whose ray through the centre meets the mesh.

    Raises:
        ValueError: The mesh is not watertight, or a pose is not finite.
    """
    require_shape("T_cam_parts", T_cam_parts, (None, 4, 4))
    if not mesh.is_watertight:
        raise ValueError("mesh must be watertight: the silhouette is drawn from its front faces")
    if not np.isfinite(T_cam_parts).all():
        bad = int(np.nonzero(~np.isfinite(T_cam_parts).all(axis=(1, 2)))[0][0])
        raise ValueError(f"the pose of part {bad} is not finite")
    counts: NDArray[np.int64] = _kernels.count_silhouettes(
        np.ascontiguousarray(mesh.vertices, np.float64),
        np.ascontiguousarray(mesh.faces, np.int32),
        np.ascontiguousarray(T_cam_parts[:, :3, :3]),
        np.ascontiguousarray(T_cam_parts[:, :3, 3]),
        K,
        *pixel_slopes(K, size[1], size[0]),
        np.array(region if region is not None else (0, 0, size[1], size[0]), np.int64),
        np.full(size, -1, np.int32),
    )
    return counts
