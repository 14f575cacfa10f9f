from .euclidean import euclidean_components as euclidean_components
from .group_merging import GroupMergingConfig as GroupMergingConfig
from .group_merging import merge_groups as merge_groups
from .similarity import GroupingConfig as GroupingConfig
from .similarity import Groups as Groups
from .similarity import group_points as group_points
from .similarity import propagate_labels as propagate_labels
