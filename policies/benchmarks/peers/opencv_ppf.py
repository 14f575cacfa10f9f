"""OpenCV's surface point pair features and ICP (``ppf_match_3d`` of opencv-contrib), for `worker.py`.

Settings that the library's samples leave open are the best for this peer on nine segments of each part at a step of
0.1. ICP registers the model's surface that faces the camera to the measured points: registering the whole model, as
the samples do, lets its self-occluded side pull the pose away (22 of 45 right instead of 27). On a segment the five
clusters with most votes are registered and the smallest residual decides; in a whole scene, where the residual is not
informative, the votes decide. Model and scene are scaled to a diameter of 1, since one threshold of the matching is
absolute.
"""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

HYPOTHESES = 5  # clusters that are registered on a segment
EVERY = 10  # stride of the measured points for ICP: 3000 of a segment's 30 000 are used
REACH = 0.6  # largest distance of registered points from a pose's centre, as a share of the diameter
ENOUGH = 100  # smallest number of points on either side of a registration
FAILED = 1e9  # residual of a failed registration; ICP returns "ok" and a residual of 1e10 then


def version() -> str:
    """Return the library's name and version."""
    return f"OpenCV {cv2.__version__}"


def build(model: Any, d_max: float, threads: int, setting: str) -> Callable[[Any, int], tuple[Any, Any]]:
    """Train on the model and return the estimator.

    Args:
        model: (M, 6) points on the part [m] with unit normals.
        d_max: Diameter of the part [m].
        threads: Number of OpenCV's threads.
        setting: Distance step as a share of the diameter.
    """
    cv2.setNumThreads(threads)
    step = float(setting)
    scaled = _scaled(model, d_max)
    detector = _ppf().PPF3DDetector(step, 0.05, 30)
    detector.trainModel(scaled)

    def estimate(points: Any, top: int) -> tuple[Any, Any]:
        cloud = _scaled(points, d_max)
        diagonal = float(np.linalg.norm(np.ptp(cloud[:, :3], axis=0)))
        clusters = detector.match(cloud, 1 / 5.0, step / diagonal)[: HYPOTHESES if top == 1 else top]
        found = [_registered(np.array(cluster.pose), scaled, cloud[::EVERY]) for cluster in clusters]
        scores = [
            -residual if top == 1 else cluster.numVotes for (_, residual), cluster in zip(found, clusters, strict=True)
        ]
        order = np.argsort(-np.array(scores, float), kind="stable")
        poses = np.reshape([T for T, _ in found], (-1, 4, 4))[order]
        poses[:, :3, 3] *= d_max
        return poses, np.array(scores, float)[order]

    return estimate


def _registered(T: Any, model: Any, cloud: Any) -> tuple[Any, float]:
    """Return the pose registered to the cloud and the residual; the same pose and `FAILED` if registration fails."""
    R = T[:3, :3]
    posed = np.hstack([model[:, :3] @ R.T + T[:3, 3], model[:, 3:] @ R.T])
    facing = posed[np.sum(posed[:, :3] * posed[:, 3:], axis=1) < -0.2 * np.linalg.norm(posed[:, :3], axis=1)]
    centre = (posed[:, :3].min(axis=0) + posed[:, :3].max(axis=0)) / 2
    near = cloud[np.linalg.norm(cloud[:, :3] - centre, axis=1) < REACH]
    if min(len(facing), len(near)) < ENOUGH:
        return T, FAILED
    source, target = (np.ascontiguousarray(points, np.float32) for points in (facing, near))
    _, residual, correction = _ppf().ICP(100, 0.005, 2.5, 8).registerModelToScene(source, target)
    moved = np.reshape(correction, (4, 4)) @ T
    if not (residual < FAILED and np.isfinite(moved).all()):
        return T, FAILED
    return moved, float(residual)


def _scaled(cloud: Any, d_max: float) -> Any:
    return np.ascontiguousarray(np.hstack([cloud[:, :3] / d_max, cloud[:, 3:]]), np.float32)


def _ppf() -> Any:
    return getattr(cv2, "ppf_match_3d")  # noqa: B009 -- of opencv-contrib, which the project's own OpenCV is not
