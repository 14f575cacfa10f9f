"""Poses in a segmented cloud: what is printed about them, and their JSON values."""

from collections.abc import Sequence
from typing import Any

from perception.pose.edge_estimator import UNCHECKED, EdgePose
from policies.clouds.segmented_cloud import SegmentedCloud

VERSION = 1  # of the JSON values


def pose_lines(poses: Sequence[EdgePose]) -> list[str]:
    """Return what to print about poses."""
    verified = sum(pose.verified for pose in poses)
    return [
        f"poses     {len(poses)}, {verified} of them verified by their edges alone",
        *(f"unchecked {text}" for text in UNCHECKED),
    ]


def pose_values(cloud: SegmentedCloud, poses: Sequence[EdgePose]) -> dict[str, Any]:
    """Return poses as JSON values; the camera frame is that of the cloud with y down and z forward, in metres."""
    return {
        "version": VERSION,
        "cloud": str(cloud.source.path),
        "unchecked": list(UNCHECKED),
        "poses": [
            {
                "T_cam_part": pose.T_cam_part.tolist(),
                "label": pose.instance_idx,
                "explained": pose.explained,
                "edges": pose.edges,
                "verified": pose.verified,
            }
            for pose in poses
        ],
    }
