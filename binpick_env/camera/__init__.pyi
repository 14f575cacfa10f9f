from .depth_camera import Capture as Capture
from .depth_camera import DepthCamera as DepthCamera
from .depth_camera import default_pose as default_pose
from .sensor import SensorModel as SensorModel
from .sensor import sensor_model as sensor_model
from .shading import Light as Light
