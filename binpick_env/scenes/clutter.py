"""How hidden the parts of a bin are: visible fractions, and the three numbers that every evaluation prints."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from binpick_env.camera import _raster_kernels as _kernels
from binpick_env.camera.depth_camera import Capture
from perception.geometry import Floats, invert_transform, require_shape


@dataclass(frozen=True, kw_only=True)
class ClutterStats:
    """Visible fractions of the parts of one bin or many, summed up.

    Attributes:
        count: Number of parts.
        median: Of the visible fraction; NaN without parts.
        below_half: Share of parts under 0.5 visible; NaN without parts.
        above_nine_tenths: Share of parts over 0.9 visible; NaN without parts.
    """

    count: int
    median: float
    below_half: float
    above_nine_tenths: float

    @classmethod
    def from_fractions(cls, fractions: Floats | Sequence[float]) -> "ClutterStats":
        """Sum up (N,) visible fractions; those of several bins may be concatenated."""
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
    """Sum bins up: median (mean of the bins' medians), below_half and above_nine_tenths (of all parts), parts."""
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
    """Return the (N,) visible fraction of each part: its pixels / its pixels if it were rendered alone.

    Args:
        capture: What the camera saw; part n carries instance id n.
        mesh: The parts' one watertight mesh, part frame [m].
        T_world_parts: (N, 4, 4) part poses.

    Returns:
        (N,) in [0, 1]; 0 for a part out of view.

    Raises:
        ValueError: If the capture shows an instance that has no pose.
    """
    require_shape("T_world_parts", T_world_parts, (None, 4, 4))
    count = len(T_world_parts)
    if capture.instance_ids.max(initial=-1) >= count:
        raise ValueError(f"the capture shows part {capture.instance_ids.max()}, but there are only {count} poses")
    seen = capture.instance_ids[capture.instance_ids >= 0]
    visible = np.bincount(seen, minlength=count)[:count]
    T_cam_parts = invert_transform(capture.T_world_cam) @ T_world_parts
    alone = silhouette_pixels(mesh, T_cam_parts, capture.frame.K, capture.instance_ids.shape, capture.region)
    # The simulation's meshes are single precision: a pixel on the outline may be seen and yet not be counted alone.
    return np.minimum(visible / np.maximum(alone, 1), 1.0) * (alone > 0)


def silhouette_pixels(
    mesh: trimesh.Trimesh,
    T_cam_parts: Floats,
    K: Floats,
    size: tuple[int, ...],
    region: tuple[int, int, int, int] | None = None,
) -> NDArray[np.int64]:
    """Count the (N,) pixels whose centre's ray meets the mesh at each of (N, 4, 4) poses, each rendered alone.

    Args:
        mesh: Watertight, part frame [m].
        T_cam_parts: (N, 4, 4) poses in the camera frame.
        K: (3, 3) pinhole matrix [px].
        size: Height and width of the image [px].
        region: Half-open rectangle ``(u0, v0, u1, v1)`` of pixels to count; the whole image by default.

    Raises:
        ValueError: If the mesh is not watertight or a pose is not finite.
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
        np.array(region if region is not None else (0, 0, size[1], size[0]), np.int64),
        np.full(size, -1, np.int32),
    )
    return counts
