"""The network groups the boundary points of a frame into parts; AP judges the groups against the truth."""

import gymnasium as gym

import binpick_env  # noqa: F401 - registers the environments
from perception.boundary import extract_boundary
from perception.instance import Instance
from perception.metrics.average_precision import ap_summary
from perception.metrics.matching import match_scene
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.scoring import truth_of
from perception.segmentation.surface import coarse_surface


def main(num_parts: int = 10) -> tuple[list[Instance], float]:
    """Return the instances and their AP50."""
    env = gym.make("BinPick-v0", part="tee", num_parts=num_parts, perception="oracle").unwrapped
    env.reset(seed=2)
    capture, workspace, part = env.labelled_capture, env.workspace, env.part.model
    frame = capture.capture.frame
    boundary = extract_boundary(frame, workspace)
    surface = coarse_surface(frame, workspace, part.d_max)
    instances = SegmentationPredictor.for_part(part).predict(boundary, surface, part.d_max)

    part_ids = capture.capture.instance_ids[boundary.pixels[:, 1], boundary.pixels[:, 0]].astype("int64")
    matches = match_scene(truth_of(part_ids, capture.visible_fractions), instances)
    summary = ap_summary([matches])
    print(f"{len(boundary)} points in {len(instances)} groups; AP50 {summary.ap50:.3f}, AP75 {summary.ap75:.3f}")
    env.close()
    return instances, summary.ap50


if __name__ == "__main__":
    main(num_parts=20)
