"""From the pose of a part in a labelled capture to a pose candidate."""

import numpy as np

from binpick_env.candidates import PoseCandidate
from binpick_env.observation.labelled_capture import LabelledCapture
from perception.geometry import Floats, transform_points


def make_candidate(
    labelled: LabelledCapture,
    T_world_part: Floats,
    *,
    score: float,
    visible_fraction: float,
    fill: float,
    part: int = -1,
) -> PoseCandidate:
    """Complete a (4, 4) pose to a candidate with the part's centre and its highest point.

    Args:
        labelled: Capture in which the part was seen.
        T_world_part: (4, 4) estimated pose.
        score: Confidence in [0, 1].
        visible_fraction: Estimated share of the part's silhouette that is seen.
        fill: Number of visible boundary points over P.
        part: True index of the part, -1 where unknown.
    """
    points_world = transform_points(T_world_part, np.asarray(labelled.part.mesh.vertices))
    return PoseCandidate(
        T_world_part=T_world_part,
        centre_world=transform_points(T_world_part, labelled.part.centre[None])[0],
        score=score,
        visible_fraction=visible_fraction,
        top=float(labelled.workspace.to_bin(points_world)[:, 2].max()),
        fill=fill,
        part=part,
    )
