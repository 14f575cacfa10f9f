"""What can be evaluated, as names that a user chooses among."""

from typing import Literal

SegmentationKind = Literal["network", "euclidean"]  # euclidean: components of points that lie close together
PosePerception = Literal["learned", "gt_masks", "whole_scene"]  # segments by a network, the true ones, or none at all
