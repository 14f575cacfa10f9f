"""The options of the cell, the same on every command that builds one."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

from binpick_env.config import Backend, SensorPreset
from binpick_env.options import CellOptions
from binpick_env.options import evaluated as evaluated
from binpick_env.options import scenes_of as scenes_of
from binpick_env.parts.unit import Unit
from perception.bin import Trust
from perception.segmentation.choices import NetworkName


@dataclass(frozen=True, kw_only=True)
class _WhichPart:
    # part_a, part_b, part_c, tee, bracket, generated:FAMILY:INDEX, or the path of an STL, OBJ, PLY, OFF, GLB, 3MF or
    # STEP file
    part: str = "tee"
    unit: Unit | None = None  # length unit of a part file's coordinates; metres or millimetres, guessed, unless given


@dataclass(frozen=True, kw_only=True)
class PileArguments:
    """What a pile in the bin depends on, besides the part."""

    symmetry: Literal["detect", "none"] = "detect"  # rotational symmetry of a part file; none: ignore it
    # largest deviation of a part file's surface from itself under a symmetry [m]; 0.5 % of its diameter unless given
    symmetry_tolerance: float | None = None
    density: float | None = None  # density of the part [kg/m^3]; the catalogue's, or 2700 for a file, unless given
    # length, width, height inside the bin [m], or one word in mm such as 360x260x120; 0.36 0.26 0.12 unless given
    bin: tuple[float, float, float] | None = None
    friction: float | None = None  # sliding friction coefficient of parts, bin and tray; 0.5 unless given


@dataclass(frozen=True, kw_only=True)
class CameraArguments:
    """What takes the frames."""

    camera_distance: float = 0.9  # distance of the camera from the bin's floor [m]
    width: int = 1280  # width of the camera's image [px]
    height: int = 960  # height of the camera's image [px]
    # renderer of the camera's frames; raster and rays give the same frames, rays is slower; egl needs a GL driver
    backend: Backend = "raster"


@dataclass(frozen=True, kw_only=True)
class PartArguments(PileArguments, _WhichPart):
    """What lies in which bin."""

    def options(self) -> CellOptions:
        """Return the options of the cell.

        Raises:
            ValueError: One of them has no meaning.
        """
        return _options(self, PartArguments)


@dataclass(frozen=True, kw_only=True)
class SceneArguments(CameraArguments, PartArguments):
    """What lies in which bin under which camera."""

    def options(self) -> CellOptions:
        """Return the options of the cell; see `PartArguments.options`."""
        return _options(self, SceneArguments)


@dataclass(frozen=True, kw_only=True)
class CellArguments(SceneArguments):
    """What lies in which bin under which camera, and is picked by which jaw."""

    jaw: float | None = None  # largest opening of the jaw [m]; the gripper's own 0.085 unless given
    max_acceleration: float | None = (
        None  # largest acceleration of a joint in planned motions [rad/s^2]; 8 if not given
    )
    max_jerk: float | None = None  # largest jerk of a joint in planned motions [rad/s^3]; no limit unless given
    sensor: SensorPreset = "good"  # noise of the depth camera
    hand_eye_mm: float = 0.0  # error of the camera's reported position, standard deviation per axis [mm]
    hand_eye_deg: float = 0.0  # error of the camera's reported orientation, standard deviation per axis [deg]
    # bin: the bin stands where it is said to be, is measured in each frame, and corrects the camera's reported pose;
    # camera: the reported pose is taken as it is
    trust: Trust = "camera"

    def options(self) -> CellOptions:
        """Return the options of the cell; see `PartArguments.options`."""
        return _options(self, CellArguments)


def _options(arguments: PartArguments, kind: type[PartArguments]) -> CellOptions:
    """Return the values of the fields that ``kind`` declares; commands add others to theirs."""
    return CellOptions(**{field.name: getattr(arguments, field.name) for field in fields(kind)})


def weights_of(options: CellOptions, network: NetworkName) -> Path:
    """Return the weights of a part, or those for every part.

    Raises:
        WeightsError: There are none of this kind; the message names the command that makes them.
    """
    from binpick_env.option_words import training_command
    from perception.segmentation.weights import WeightsError, find_weights  # here, since it loads torch

    try:
        return find_weights(options.load_part().model, network).path
    except WeightsError as error:
        command = training_command(options, network)
        raise WeightsError(f"{error}; weights of this part alone: {command}") from error
