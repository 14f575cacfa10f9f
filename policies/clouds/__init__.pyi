from .cloud_poses import pose_lines as pose_lines
from .cloud_poses import pose_values as pose_values
from .cloud_report import write_cloud_report as write_cloud_report
from .segmented_cloud import CloudSource as CloudSource
from .segmented_cloud import SegmentedCloud as SegmentedCloud
from .segmented_cloud import cloud_lines as cloud_lines
from .segmented_cloud import segment_cloud as segment_cloud
