"""Whether a refined bin can be believed."""

import numpy as np

from perception.bin.cloud import GridCloud
from perception.bin.edges import RimEdges
from perception.bin.first_guess import FARTHEST, STEEPEST, Prior
from perception.bin.refinement import WALLS, Refined
from perception.geometry import Floats, invert_transform, rotation_angle, transform_points

_LEAST_TRANSLATION, _LEAST_ROTATION = 0.0002, 0.0003  # errors of a sensor that no number of points averages out
_MOST_TRANSLATION, _MOST_ROTATION = 0.003, np.deg2rad(0.7)  # standard deviations above which a fit says nothing
_MISFIT, _MISFIT_SHARE = 0.012, 0.05  # largest difference of opening and stated size, in metres and as a share
_BELOW, _BELOW_SHARE = 0.006, 0.1  # depth below the floor [m], and share of the points there with which it is wrong


def opening_of(refined: Refined, edges: RimEdges | None) -> Floats:
    """Return the (2,) measured length and width of the opening [m]; NaN where not both of its edges were seen."""
    if edges is None:
        return np.full(2, np.nan)
    both = np.isfinite(edges.offsets).reshape(2, 2).all(axis=1)
    return np.where(both, refined.state.opening, np.nan)


def why_unreliable(refined: Refined, opening: Floats, cloud: GridCloud, prior: Prior) -> str | None:
    """Return why a refined bin cannot be believed; None if it can.

    Args:
        refined: The bin.
        opening: (2,) measured length and width of its opening [m], or NaN.
        cloud: Points of the frame.
        prior: What was known of the bin before.
    """
    points = refined.points
    if points["floor"] == points["rim"] == 0:
        return "neither its floor nor its rim is seen"
    seen = [any(points[name] > 0 for name in WALLS[axis : axis + 2]) for axis in (0, 2)]
    if seen[0] != seen[1]:
        return f"only the walls at the ends of its {'length' if seen[0] else 'width'} are seen"
    if prior.inner_size is not None:
        stated = prior.inner_size[:2]
        if is_another_size(opening, stated):
            return f"its opening measures {size_in_mm(opening)} mm, but inner_size says {size_in_mm(stated)} mm"
    translation, rotation = uncertainty(refined, walls=seen[0])
    if translation > _MOST_TRANSLATION or rotation > _MOST_ROTATION:
        return (
            f"too little of it is seen: its pose is uncertain by {1000 * translation:.1f} mm and "
            f"{np.degrees(rotation):.2f} degrees"
        )
    if prior.T_cam_bin is not None:
        T = invert_transform(prior.T_cam_bin) @ refined.state.T_cam_bin
        distance, angle = float(np.linalg.norm(T[:3, 3])), float(rotation_angle(T[:3, :3]))
        if distance > FARTHEST or angle > STEEPEST:
            return (
                f"what looks like it lies {1000 * distance:.0f} mm and {np.degrees(angle):.0f} degrees from where it "
                "is said to be"
            )
    heights = _heights_inside(refined, cloud)
    below = float(np.mean(heights < -_BELOW)) if len(heights) else 0.0
    if below > _BELOW_SHARE:
        return f"{100 * below:.0f} % of what is measured in it lies below its floor"
    return None


def least_height(refined: Refined, cloud: GridCloud) -> float:
    """Return the least height that a bin must have for what is measured in it [m].

    It is NaN if the bin is high enough, and where its rim was not seen.
    """
    heights = _heights_inside(refined, cloud)
    if refined.points["rim"] == 0 or len(heights) == 0:
        return float("nan")
    low = float(np.quantile(heights, _BELOW_SHARE / 2))
    return float(refined.state.size[2]) + refined.state.lift - low if low < -_BELOW else float("nan")


def _heights_inside(refined: Refined, cloud: GridCloud) -> Floats:
    """Return the (N,) heights of the points between the walls of a bin above its floor [m]."""
    p = transform_points(invert_transform(refined.state.T_cam_bin), cloud.points_cam)
    inside = np.all(np.abs(p[:, :2]) <= refined.state.size[:2] / 2 - _BELOW, axis=1)
    heights: Floats = p[inside, 2]
    return heights


def is_another_size(opening: Floats, stated: Floats) -> bool:
    """Return whether the (2,) measured opening is not that of the stated bin [m]; NaN is like any other length."""
    return bool(np.any(np.abs(opening - stated) > np.maximum(_MISFIT, _MISFIT_SHARE * stated)))


def uncertainty(refined: Refined, walls: bool) -> tuple[float, float]:
    """Return the standard deviations of the position [m] and of the orientation [rad] along their worst axes.

    Args:
        refined: The bin.
        walls: Whether walls were seen; without them only height and tilt are measured.
    """
    C = refined.covariance
    moved, turned = (C[:3, :3], C[3:, 3:]) if walls else (C[2:3, 2:3], C[3:5, 3:5])
    translation = float(np.sqrt(np.linalg.eigvalsh(moved).max() + _LEAST_TRANSLATION**2))
    return translation, float(np.sqrt(np.linalg.eigvalsh(turned).max() + _LEAST_ROTATION**2))


def size_in_mm(size: Floats) -> str:
    """Return lengths [m] as text in mm; those that are not known are question marks."""
    return " x ".join("?" if np.isnan(value) else f"{1000 * value:.0f}" for value in size)
