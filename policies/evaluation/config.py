"""The settings of an evaluation: all that its records depend on."""

import hashlib
import json
import logging
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from binpick_env.config import CameraConfig, CellConfig, Perception, SensorPreset
from binpick_env.observation.factory import make_perceiver
from binpick_env.observation.oracle import PoseNoise
from binpick_env.option_words import training_command
from binpick_env.options import CellOptions
from binpick_env.part_limits import require_room
from binpick_env.parts.part import Part
from binpick_env.parts.unit import Unit
from perception.bin import Trust
from perception.runtime.job_files import local_file
from perception.runtime.records import RecordError
from perception.segmentation.choices import NetworkName
from policies.picking.settings import PickerSettings

_log = logging.getLogger(__name__)
# Fields that the digest leaves out where they are None, so that folders of older runs keep their digest.
_NEWER_FIELDS = ("jaw", "friction", "symmetry_tolerance", "hand_eye_deg", "trust", "max_acceleration", "max_jerk")


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """All that a bin's record depends on, apart from its index: neither the number of bins nor of processes is here."""

    part: str = "tee"  # name of a catalogue or generated part, or path of a mesh file
    unit: Unit | None = None  # unit of a part file's coordinates; None guesses metres or millimetres
    symmetry: Literal["detect", "none"] = "detect"  # whether rotational symmetry is looked for in a part file's shape
    density: float | None = None  # [kg/m^3]; None takes the catalogue's, or aluminium's for a file
    seed: int = 0  # seed of the whole evaluation; see `bin_seed`
    perception: Perception = "learned"  # where candidates come from: pixels, true segments or true poses
    sensor: SensorPreset = "good"  # noise of the depth camera
    num_parts: tuple[int, int] = (20, 30)  # smallest and largest number of parts in a bin
    camera: CameraConfig = field(default_factory=CameraConfig)  # image size, place and rendering of the camera
    pose_noise: PoseNoise = field(default_factory=PoseNoise)  # error of the poses where perception is "oracle"
    picker: PickerSettings = field(default_factory=PickerSettings)  # how grasps are planned
    bin: tuple[float, float, float] | None = None  # length, width, height inside [m]; None is the standard bin
    jaw: float | None = None  # largest opening of the jaw [m]; None is the gripper's own
    friction: float | None = None  # sliding friction coefficient of parts, bin and tray; None is the cell's own
    # largest deviation of a part file's surface from itself under a symmetry [m]; None is 0.5 % of its diameter
    symmetry_tolerance: float | None = None
    # error of the camera's reported orientation, standard deviation per axis [deg]; None is none
    hand_eye_deg: float | None = None
    trust: Trust | None = None  # "bin" corrects the camera's reported pose by the bin in its frames; None does not
    # largest acceleration of a joint in planned motions [rad/s^2]; None is the cell's own
    max_acceleration: float | None = None
    max_jerk: float | None = None  # largest jerk of a joint in planned motions [rad/s^3]; None is no limit
    network: NetworkName = "grid"  # kind of the segmentation network where perception is "learned"

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")
        self.options()
        low, high = self.num_parts
        if not 1 <= low <= high:
            raise ValueError(f"num_parts must be a rising pair from 1, got {self.num_parts}")

    def digest(self) -> str:
        """Return a hash of every setting, and of the part file's contents where the part is a file."""
        values = asdict(self)
        for name in _NEWER_FIELDS:
            if values[name] is None:
                del values[name]
        if self.network == "grid":  # nor do older runs know other networks
            del values["network"]
        path = local_file(Path(self.part))
        if path.suffix and path.is_file():
            values["part"] = hashlib.sha256(path.read_bytes()).hexdigest()
        return hashlib.sha256(json.dumps(values, sort_keys=True, default=repr).encode()).hexdigest()[:16]

    def options(self) -> CellOptions:
        """Return the part and the cell, except for the camera's image, as flat values."""
        return CellOptions(
            part=self.part,
            unit=self.unit,
            symmetry=self.symmetry,
            density=self.density,
            symmetry_tolerance=self.symmetry_tolerance,
            bin=self.bin,
            jaw=self.jaw,
            max_acceleration=self.max_acceleration,
            max_jerk=self.max_jerk,
            camera_distance=self.camera.distance,
            sensor=self.sensor,
            friction=self.friction,
            hand_eye_deg=self.hand_eye_deg or 0.0,
            trust=self.trust or "camera",
        )

    def weights(self) -> dict[str, str] | None:
        """Return name, SHA-256 and training of the network that segments.

        It is None where perception uses none, and where the part's file or its network is there no longer: stored
        records can be summarised without them.
        """
        if self.perception != "learned":
            return None
        from perception.segmentation.weights import find_weights  # here, since it loads torch

        try:
            found = find_weights(self.options().load_part().model, self.network)
        except (OSError, ValueError) as error:
            _log.warning("the weights of these records are not known: %s", error)
            return None
        sha256 = hashlib.sha256(found.path.read_bytes()).hexdigest()
        return {"name": found.path.name, "sha256": sha256, "training": found.training}

    def cell(self) -> CellConfig:
        """Return the settings of the cell, the camera's included."""
        return replace(self.options().cell(), camera=self.camera)

    def check(self) -> Part:
        """Load what the configuration names, before any worker starts, and return the part.

        What takes least time comes first: a part that the jaw cannot grasp is refused before perception is prepared.

        Raises:
            ValueError: There is no such part or perception mode, the part's file is not usable, the bin does not hold
                so many of it, the jaw finds no grasp on it, or there are no weights for it where perception is
                "learned".
            FileNotFoundError: The part's file does not exist.
        """
        part = self.options().load_part()
        from policies.grasping.grasps import sample_grasps, why_no_grasp  # here, since it loads the kernels

        if len(sample_grasps(part.model, jaw=self.jaw)) == 0:
            raise ValueError(why_no_grasp(part.model, jaw=self.jaw))
        require_room(part, self.cell().bin, self.num_parts[1])
        workspace = self.cell().bin.workspace()
        try:
            make_perceiver(self.perception, part.model, workspace, self.pose_noise, network=self.network)
        except RecordError as error:  # a WeightsError, without loading torch for its name
            command = training_command(self.options(), self.network)
            raise type(error)(f"{error}; weights of this part alone: {command}") from error
        return part


def bin_seed(seed: int, index: int) -> int:
    """Return the seed of bin ``index``: numpy's SeedSequence over (seed, index), so that no two evaluations overlap.

    The seed depends on nothing else: neither on the number of bins or workers, nor on their order.
    """
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
