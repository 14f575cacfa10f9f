"""Every setting of the cell, as frozen dataclasses. Lengths [m], angles [rad], times [s], world frame unless said."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from perception.bin import Trust, check_trust
from perception.runtime.field_types import require_field_types, require_finite

if TYPE_CHECKING:
    from perception.frame import Workspace

CONTROL_PERIOD = 0.04  # time between two actions of the environment [s]
Backend = Literal["rays", "egl", "raster"]
SensorPreset = Literal["none", "good", "harsh", "stereo", "tof"]
SensorChoice = SensorPreset | Literal["mixed", "all"]  # mixed, all: a preset drawn for each scene
AppearanceChoice = Literal["clean", "varied"]  # varied: an appearance drawn for each scene
Perception = Literal["oracle", "gt_masks", "learned"]  # what finds the parts in a frame
PAYLOAD = 5.0  # largest mass that a UR5e may carry, the gripper included [kg]: its data sheet
GRIPPER_MASS = 0.925  # mass of the 2F-85 [kg]: its data sheet
GRIPPER_STROKE = 0.085  # largest distance between the 2F-85's pads [m]: its data sheet


def _require_numbers(config: object) -> None:
    require_field_types(config)
    require_finite(config)


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True, kw_only=True)
class BinConfig:
    """The bin and where it stands. The world's origin is under the robot's base, z = 0 is the table's top."""

    inner_size: tuple[float, float, float] = (0.36, 0.26, 0.12)  # length, width, height inside [m]
    wall: float = 0.02  # thickness of walls and floor [m]; thick, so that nothing tunnels
    position: tuple[float, float] = (0.50, 0.0)  # centre in the world's x and y [m]
    yaw: float = np.pi / 2  # bin x axis against world x [rad]; the long side runs across the robot's view

    def __post_init__(self) -> None:
        _require_numbers(self)
        _require(min(self.inner_size) > 0, f"inner_size must be positive, got {self.inner_size}")
        _require(self.wall >= 0.005, f"wall must be at least 0.005 m, got {self.wall}")

    def workspace(self) -> "Workspace":
        """Return the bin's pose and inner box."""
        # Here, since the settings are read by command lines that must not load scipy.
        from perception.frame import Workspace
        from perception.geometry import make_transform, rotation_about

        centre = (*self.position, self.wall)
        T_world_bin = make_transform(rotation_about((0, 0, 1), self.yaw), centre)
        return Workspace(T_world_bin=T_world_bin, inner_size=np.array(self.inner_size))


@dataclass(frozen=True, kw_only=True)
class TrayConfig:
    """The drop tray beside the bin."""

    inner_size: tuple[float, float, float] = (0.24, 0.24, 0.06)  # length, width, height inside [m]
    wall: float = 0.01  # thickness of walls and floor [m]
    position: tuple[float, float] = (0.42, -0.42)  # centre in the world's x and y [m]

    def __post_init__(self) -> None:
        _require_numbers(self)
        _require(min(self.inner_size) > 0, f"inner_size must be positive, got {self.inner_size}")
        _require(self.wall > 0, f"wall must be positive, got {self.wall}")


@dataclass(frozen=True, kw_only=True)
class CameraConfig:
    """The overhead depth camera. Its optical axis points straight down through the bin's centre."""

    width: int = 1280  # width of the image [px]
    height: int = 960  # height of the image [px]
    focal: float = 2400.0  # focal length of an image 1280 px wide [px]; scaled with `width`
    distance: float = 0.9  # distance from the bin's floor [m]
    hand_eye: float = 0.0  # standard deviation per axis of the reported position's error [m]; drawn for each bin
    backend: Backend = "raster"  # same image as "rays" (MuJoCo's mj_multiRay), ten times faster; "egl" needs GL

    def __post_init__(self) -> None:
        _require_numbers(self)
        size = f"{self.width} x {self.height}"
        _require(self.width >= 16 and self.height >= 16, f"the image must be at least 16 x 16, got {size}")
        _require(self.focal > 0, f"focal must be positive, got {self.focal}")
        _require(self.distance > 0.2, f"distance must exceed 0.2 m, got {self.distance}")
        _require(0 <= self.hand_eye <= 0.015, f"hand_eye must be from 0 to 0.015 m, got {self.hand_eye}")
        known = get_args(Backend)
        _require(self.backend in known, f"backend must be one of {', '.join(known)}, got {self.backend!r}")

    @property
    def focal_px(self) -> float:
        """Focal length in this image's pixels."""
        return self.focal * self.width / 1280


@dataclass(frozen=True, kw_only=True)
class CalibrationConfig:
    """How well the camera's orientation is known, and whether the bin in its frames corrects its pose.

    The error of its position is :attr:`CameraConfig.hand_eye`.
    """

    rotation: float = 0.0  # standard deviation per axis of the reported orientation's error [rad]; drawn for each bin
    # "camera" takes the reported pose as it is, "bin" corrects it by the bin, which is measured in each frame
    trust: Trust = "camera"

    def __post_init__(self) -> None:
        _require_numbers(self)
        _require(0 <= self.rotation <= 0.06, f"rotation must be from 0 to 0.06 rad, got {self.rotation}")
        check_trust(self.trust)


@dataclass(frozen=True, kw_only=True)
class RobotConfig:
    """Mounting of the arm, limits of its motion, and the gripper."""

    pedestal_height: float = 0.15  # height of the arm's base above the table [m]
    max_velocity: float = np.pi  # largest velocity of a joint [rad/s]: the UR5e's data sheet, 180 deg/s
    max_acceleration: float = 8.0  # largest acceleration of a joint [rad/s^2]; torques would allow more near the base
    max_jerk: float | None = None  # largest jerk of a joint in planned motions [rad/s^3]; None for no limit
    gripper_time: float = 0.57  # time that the jaw takes for its whole stroke [s]: the 2F-85's data sheet, 150 mm/s
    protective_stop: float | None = 150.0  # force at the tool at which the arm stops [N]: the UR5e's; None for no stop
    jaw: float | None = None  # largest opening of the jaw [m]; None for the gripper's own stroke of 0.085 m

    def __post_init__(self) -> None:
        _require_numbers(self)
        for name in ("pedestal_height", "max_velocity", "max_acceleration", "gripper_time"):
            _require(getattr(self, name) > 0, f"{name} must be positive, got {getattr(self, name)}")
        jerk = self.max_jerk
        _require(jerk is None or jerk > 0, f"max_jerk must be positive, or None for no limit, got {jerk}")
        stop = self.protective_stop
        _require(stop is None or stop > 0, f"protective_stop must be positive, or None for no stop, got {stop}")
        stroke = f"must be over 0 and at most {GRIPPER_STROKE} m, the 2F-85's stroke"
        _require(self.jaw is None or 0 < self.jaw <= GRIPPER_STROKE, f"jaw {stroke}, got {self.jaw}")


@dataclass(frozen=True, kw_only=True)
class ContactConfig:
    """Contact and damping of parts, bin and tray: the settings under which a pile comes to rest and sleeps."""

    condim: int = 6  # MuJoCo's dimension of contacts: 6 has sliding, torsional and rolling friction
    friction: tuple[float, float, float] = (0.5, 0.005, 0.0002)  # coefficients: sliding [-], torsional [m], rolling [m]
    solref: tuple[float, float] = (0.01, 1.0)  # time constant [s] and damping ratio of contacts; thin parts: stiffer
    solimp: tuple[float, float, float, float, float] = (0.9, 0.95, 0.001, 0.5, 2.0)  # impedance; MuJoCo's default
    joint_damping: float = 1e-4  # damping of the parts' free joints [N s/m and N m s]
    sleep_tolerance: float = 1e-2  # velocity below which an island of parts falls asleep [m/s, length-weighted rad/s]

    def __post_init__(self) -> None:
        _require_numbers(self)
        _require(self.condim in (1, 3, 4, 6), f"condim must be 1, 3, 4 or 6, got {self.condim}")
        _require(min(self.friction) >= 0, f"friction must not be negative, got {self.friction}")
        _require(self.joint_damping >= 0, f"joint_damping must not be negative, got {self.joint_damping}")
        _require(self.sleep_tolerance > 0, f"sleep_tolerance must be positive, got {self.sleep_tolerance}")


@dataclass(frozen=True, kw_only=True)
class CellConfig:
    """Everything in the cell but the parts."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    bin: BinConfig = field(default_factory=BinConfig)
    tray: TrayConfig = field(default_factory=TrayConfig)
    contact: ContactConfig = field(default_factory=ContactConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    timestep: float = 0.002  # time step of the physics [s]; the control period is a whole number of steps

    def __post_init__(self) -> None:
        _require_numbers(self)
        steps = CONTROL_PERIOD / self.timestep if self.timestep > 0 else 0.0
        _require(
            steps >= 1 and abs(steps - round(steps)) < 1e-9,
            f"timestep must divide the control period of {CONTROL_PERIOD} s, got {self.timestep}",
        )
