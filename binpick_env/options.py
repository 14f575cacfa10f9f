"""The options of a cell that a user changes most, as flat values: environments and command lines share them."""

from dataclasses import dataclass, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from binpick_env.config import (
    Backend,
    BinConfig,
    CalibrationConfig,
    CameraConfig,
    CellConfig,
    ContactConfig,
    RobotConfig,
    SensorPreset,
    TrayConfig,
)
from binpick_env.parts.density import check_density
from binpick_env.parts.symmetry_tolerance import check_symmetry_tolerance
from binpick_env.parts.unit import Unit, check_unit
from perception.bin import Trust
from perception.bin.unit import bin_words
from perception.runtime.field_types import require_field_types, require_finite

if TYPE_CHECKING:
    from binpick_env.parts.part import Part

MAX_FRICTION = 2.0  # rubber on dry concrete reaches 1; what exceeds this is a percentage or a mistake
MAX_HAND_EYE_MM = 15.0  # [mm]; the limit of `CameraConfig.hand_eye`
MAX_HAND_EYE_DEG = 3.0  # [deg]; about the limit of `CalibrationConfig.rotation`
_LEAST_BIN = 0.05  # longest inner side of a bin [m], below which no pile of the smallest parts lies in it
_CAMERA_MM = 100.0  # no camera is so far from a bin: such a distance is no metres [m]
_PEDESTAL_HALF = 0.09  # half the side of the robot's pedestal, which stands at the world's origin [m]
# The arguments of an environment that hold other options: what may not be given beside them.
_IN_CAMERA = ("camera_distance", "width", "height", "backend", "hand_eye_mm")
_OF_ROBOT = ("jaw", "max_acceleration", "max_jerk")
_IN_CONFIG = ("bin", *_OF_ROBOT, "friction", "hand_eye_deg", "trust", *_IN_CAMERA)


@dataclass(frozen=True, kw_only=True)
class CellOptions:
    """What is picked, in which bin, by which jaw, under which camera. The defaults are the standard cell."""

    part: str = "tee"  # catalogue name, or path to a mesh file
    unit: Unit | None = None  # unit of a mesh file's coordinates; guessed from the part's size unless given
    symmetry: Literal["detect", "none"] = "detect"  # "none" takes every rotation of the part for another pose
    density: float | None = None  # density of the part [kg/m^3]; the catalogue's, or aluminium's for a file
    # largest deviation of a file's surface from itself under a symmetry [m]; 0.5 % of the diameter unless given
    symmetry_tolerance: float | None = None
    bin: tuple[float, float, float] | None = None  # length, width, height inside the bin [m]; the standard bin's
    jaw: float | None = None  # largest opening of the jaw [m]; the gripper's own unless given
    # largest acceleration of a joint in planned motions [rad/s^2]; the cell's own unless given
    max_acceleration: float | None = None
    max_jerk: float | None = None  # largest jerk of a joint in planned motions [rad/s^3]; no limit unless given
    camera_distance: float = 0.9  # distance of the camera from the bin's floor [m]
    width: int = 1280  # width of the image [px]
    height: int = 960  # height of the image [px]
    backend: Backend = "raster"  # what renders the depth image
    sensor: SensorPreset = "good"  # noise of the depth image
    hand_eye_mm: float = 0.0  # standard deviation per axis of the error of the camera's reported position [mm]
    friction: float | None = None  # sliding friction coefficient of parts, bin and tray; the cell's own unless given
    hand_eye_deg: float = 0.0  # standard deviation per axis of the error of the camera's reported orientation [deg]
    trust: Trust = "camera"  # "bin" corrects the camera's reported pose by the bin, which is measured in each frame

    def __post_init__(self) -> None:
        if self.bin is not None:
            _check_bin(self.bin)  # first, since its text says more than the next one's
        require_field_types(self)
        require_finite(self)
        if self.unit is not None:
            check_unit(self.unit)
        if self.symmetry not in ("detect", "none"):
            raise ValueError(f"symmetry must be 'detect' or 'none', got {self.symmetry!r}")
        if self.symmetry_tolerance is not None:
            check_symmetry_tolerance(self.symmetry_tolerance)
        if self.density is not None:
            check_density(self.density)
        if self.sensor not in get_args(SensorPreset):
            raise ValueError(f"sensor must be one of {', '.join(get_args(SensorPreset))}, got {self.sensor!r}")
        floor = max(0.2, BinConfig().inner_size[2] if self.bin is None else self.bin[2])
        if not floor < self.camera_distance < np.inf:
            raise ValueError(
                f"camera_distance must exceed {floor:g} m (0.2 m or the bin's height), got {self.camera_distance:g} m"
            )
        if self.camera_distance >= _CAMERA_MM:
            raise ValueError(
                f"camera_distance must be in metres, got {self.camera_distance:g} m, which seems to be millimetres: "
                "divide it by 1000"
            )
        if not 0 <= self.hand_eye_mm <= MAX_HAND_EYE_MM:
            raise ValueError(f"hand_eye_mm must be from 0 to {MAX_HAND_EYE_MM:g} mm, got {self.hand_eye_mm}")
        if not 0 <= self.hand_eye_deg <= MAX_HAND_EYE_DEG:
            raise ValueError(f"hand_eye_deg must be from 0 to {MAX_HAND_EYE_DEG:g} degrees, got {self.hand_eye_deg}")
        if self.friction is not None and not 0 <= self.friction <= MAX_FRICTION:
            raise ValueError(f"friction must be from 0 to {MAX_FRICTION:g}, got {self.friction}")
        self.cell()  # what the cell's own settings refuse: jaw, acceleration, jerk, image size, backend

    def load_part(self) -> "Part":
        """Load the part. The log says if it fits no jaw.

        Raises:
            ValueError: There is no such part, its file does not hold a watertight mesh, or its size is not the cell's.
            FileNotFoundError: There is no such file.
        """
        # Here, since command lines read the options and must not load the mesh libraries for that.
        from binpick_env.part_limits import check_part

        part = self.read_part()
        check_part(part, self.cell())
        return part

    def read_part(self) -> "Part":
        """Load the part, whether or not the cell takes one of its size.

        Raises:
            ValueError: There is no such part, or its file does not hold a watertight mesh.
            FileNotFoundError: There is no such file.
        """
        from binpick_env.parts.part import load_part

        return load_part(
            self.part,
            unit=self.unit,
            symmetry=self.symmetry,
            density=self.density,
            symmetry_tolerance=self.symmetry_tolerance,
        )

    def cell(self) -> CellConfig:
        """Return the cell's settings."""
        standard, contact = BinConfig(), ContactConfig()
        if self.friction is not None:
            contact = replace(contact, friction=(self.friction, *contact.friction[1:]))
        robot = {name: getattr(self, name) for name in _OF_ROBOT if getattr(self, name) is not None}
        camera = CameraConfig(
            width=self.width,
            height=self.height,
            distance=self.camera_distance,
            hand_eye=self.hand_eye_mm / 1000,
            backend=self.backend,
        )
        return CellConfig(
            bin=standard if self.bin is None else replace(standard, inner_size=(self.bin[0], self.bin[1], self.bin[2])),
            robot=RobotConfig(**robot),
            contact=contact,
            camera=camera,
            calibration=CalibrationConfig(rotation=float(np.deg2rad(self.hand_eye_deg)), trust=self.trust),
        )


def evaluated(options: CellOptions) -> dict[str, Any]:
    """Return options as the fields of an evaluation of picks, which has the camera as a whole."""
    names = ("part", "unit", "symmetry", "symmetry_tolerance", "density", "bin", *_OF_ROBOT, "sensor", "friction")
    values = {name: getattr(options, name) for name in names}
    calibration = {"hand_eye_deg": options.hand_eye_deg or None, "trust": "bin" if options.trust == "bin" else None}
    return {**values, **calibration, "camera": options.cell().camera}


def scenes_of(options: CellOptions) -> dict[str, Any]:
    """Return options as the fields of synthetic scenes, which have the camera as a whole."""
    names = ("part", "unit", "symmetry", "symmetry_tolerance", "density", "bin", "friction")
    return {**{name: getattr(options, name) for name in names}, "camera": options.cell().camera}


def resolve_cell(config: CellConfig | None, camera: CameraConfig | None, **options: Any) -> CellConfig:
    """Return the cell that an environment's arguments describe: as a whole, or option by option.

    Args:
        config: The whole cell; None for the standard one with the options below.
        camera: The camera, in place of the config's; None leaves it.
        options: Fields of :class:`CellOptions` that ``config`` or ``camera`` contain; None where not given.

    Raises:
        ValueError: An option is given beside the config or the camera that contains it, or has no meaning.
    """
    for name, value, kind in (("config", config, CellConfig), ("camera", camera, CameraConfig)):
        if value is not None and not isinstance(value, kind):
            raise ValueError(f"{name} must be a {kind.__name__}, got {repr(value)[:60]}: make one of its fields")
    given = {name: value for name, value in options.items() if value is not None}
    for whole, name, contained in ((config, "config", _IN_CONFIG), (camera, "camera", _IN_CAMERA)):
        twice = [option for option in given if option in contained]
        if whole is not None and twice:
            raise ValueError(f"{', '.join(twice)} cannot be given beside {name}, which contains it: set it in {name}")
    cell = CellOptions(**given).cell() if config is None else config
    return cell if camera is None else replace(cell, camera=camera)


def _check_bin(inner_size: tuple[float, float, float]) -> None:
    """Refuse a bin that is none, or that overlaps the robot's pedestal or the tray."""
    sides = inner_size if isinstance(inner_size, tuple | list | np.ndarray) else ()
    if len(sides) != 3 or not all(isinstance(side, Real) and 0 < side < np.inf for side in sides):
        raise ValueError(f"bin must be length, width and height inside [m], all positive, got {inner_size}")
    standard, tray = BinConfig(), TrayConfig()  # the bin's length lies along the world's y axis
    beside = abs(standard.position[1] - tray.position[1]) - tray.inner_size[1] / 2 - tray.wall
    length, width = 2 * (beside - standard.wall), 2 * (standard.position[0] - _PEDESTAL_HALF - standard.wall)
    if inner_size[0] > length + 1e-9 or inner_size[1] > width + 1e-9:
        raise ValueError(
            f"bin may be up to {length:.2f} m long and {width:.2f} m wide between robot and tray, got {inner_size} [m]"
            + _meant(bin_words(inner_size, without="metres", longest=max(length, width)))
        )
    if max(inner_size) < _LEAST_BIN:
        raise ValueError(
            f"bin must be at least {_LEAST_BIN:g} m long inside, got {tuple(float(side) for side in inner_size)} [m]"
            + _meant(bin_words([1000 * side for side in inner_size], without="millimetres"))
        )


def _meant(words: str) -> str:
    """Return what is said of the unit of a bin's size; nothing where none makes it plausible."""
    return f": type {words} (in Python, bin= is in metres)" if words else ""
