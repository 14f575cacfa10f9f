"""Open3D's FPFH features, RANSAC and ICP, for `worker.py`. It is not reproducible, seeded or not.

Both registrations go from segment to model, so that the self-occluded side of the model cannot pull the pose away.
None of the settings tried on development scenes (voxels of 0.02 to 0.05 diameters, RANSAC and ICP in either direction,
up to a million iterations, the given normals or Open3D's) was clearly better on both the tee and the bracket.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

VOXEL = 0.04  # voxel size as a share of the diameter
GATES = (0.1, 0.05, 0.02)  # correspondence distances of the stages of ICP, as shares of the diameter
ITERATIONS = 100_000  # of RANSAC


def version() -> str:
    """Return the library's name and version."""
    return f"Open3D {_open3d().__version__}"


def build(model: Any, d_max: float, threads: int, setting: str) -> Callable[[Any, int], tuple[Any, Any]]:  # noqa: ARG001
    """Compute the model's features and return the estimator.

    Args:
        model: (M, 6) points on the part [m] with unit normals.
        d_max: Diameter of the part [m].
        threads: Unused; environment variables limit Open3D's threads.
        setting: Unused.
    """
    o3d = _open3d()
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    registration, voxel = o3d.pipelines.registration, VOXEL * d_max
    whole = _cloud(model)
    model_down, model_features = _features(whole, voxel)
    checks = [
        registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
        registration.CorrespondenceCheckerBasedOnDistance(1.5 * voxel),
    ]
    point_to_point = registration.TransformationEstimationPointToPoint(False)
    point_to_plane = registration.TransformationEstimationPointToPlane()
    stop = registration.RANSACConvergenceCriteria(ITERATIONS, 0.999)
    settled = registration.ICPConvergenceCriteria(1e-7, 1e-7, 100)

    def estimate(points: Any, top: int) -> tuple[Any, Any]:  # noqa: ARG001
        segment = _cloud(points)
        down, features = _features(segment, voxel)
        found = registration.registration_ransac_based_on_feature_matching(
            down, model_down, features, model_features, True, 1.5 * voxel, point_to_point, 3, checks, stop
        )
        fine = segment.voxel_down_sample(voxel / 3)
        for gate in GATES:
            start = found.transformation
            found = registration.registration_icp(fine, whole, gate * d_max, start, point_to_plane, settled)
        return np.linalg.inv(found.transformation)[None], np.array([found.fitness])

    return estimate


def _features(cloud: Any, voxel: float) -> tuple[Any, Any]:
    o3d = _open3d()
    down = cloud.voxel_down_sample(voxel)
    down.normalize_normals()
    around = o3d.geometry.KDTreeSearchParamHybrid(5 * voxel, 100)
    return down, o3d.pipelines.registration.compute_fpfh_feature(down, around)


def _cloud(points: Any) -> Any:
    o3d = _open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points[:, :3]))
    cloud.normals = o3d.utility.Vector3dVector(points[:, 3:])
    return cloud


def _open3d() -> Any:
    return import_module("open3d")
