from .candidates import expected_points as expected_points
from .candidates import nearest_groups as nearest_groups
from .clustering import ClusterConfig as ClusterConfig
from .clustering import cluster_poses as cluster_poses
from .estimator import PoseEstimator as PoseEstimator
from .estimator_config import EstimatorConfig as EstimatorConfig
from .pose_estimate import PoseEstimate as PoseEstimate
