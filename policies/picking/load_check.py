"""Telling one part in the jaw from more: by the distance between the pads, by the weight, and by what is gone."""

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from binpick_env.cell.simulation import Simulation
from binpick_env.cell.wrist_force import GRAVITY, WristForceNoise, WristForceSensor
from binpick_env.config import CONTROL_PERIOD
from perception.geometry import Floats
from policies.grasping.gripper import GripperModel
from policies.grasping.outcomes import DoubleCheck

_LAST = 3  # number of readings that tell whether a load rests on something
_RISEN = 0.5  # share of the gripper's rise from which a part has come along


@dataclass(frozen=True, kw_only=True)
class DoubleSettings:
    """How more than one part in the jaw are found, and whether they are put back."""

    put_back: bool = True  # whether parts that are found to be more than one are put back into the bin
    jaw: bool = True  # whether the distance between the pads is a reason
    weight: bool = True  # whether the weight is a reason
    # distance between the pads beyond the grasp's from which there is more than a part [m]
    jaw_tolerance: float = 0.004
    readings: int = 8  # number of readings of the force, one a control period, that are averaged at the end of the lift
    force: WristForceNoise = field(default_factory=WristForceNoise)  # errors of the force sensor
    drop: float = 0.015  # height of the load above the pile at which it is let go [m]
    second_drop: float = 0.08  # the same for parts that were put back together before: the fall is to part them
    scale: float = 0.4  # share of velocity and acceleration limits used with the load that is put back
    deviations: float = 2.0  # standard deviations of the mean by which the weight must at least exceed one part's
    # whether an image of the bin decides where the weight is a reason, but that of one part and of two are too near
    image: bool = True
    sure: float = 2.5  # standard deviations of the mean within which the weight may be that of one part, or of two
    # area that is gone from the bin beside or on the picked part, as a share of its mean silhouette, beyond which more
    # than one part came along
    most_gone: float = 0.5

    def __post_init__(self) -> None:
        if self.readings < 1:
            raise ValueError(f"readings must be at least 1, got {self.readings}")
        if not (0 < self.drop < np.inf and 0 < self.second_drop < np.inf and 0 < self.scale <= 1):
            given = f"{self.drop}, {self.second_drop} and {self.scale}"
            raise ValueError(f"drop and second_drop must be positive and scale in (0, 1], got {given}")
        if not (self.jaw_tolerance > 0 and self.deviations >= 0):
            values = self.jaw_tolerance, self.deviations
            raise ValueError(f"jaw_tolerance must be positive and deviations at least 0, got {values}")
        if not (self.sure >= 0 and self.most_gone > 0):
            values = self.sure, self.most_gone
            raise ValueError(f"sure must be at least 0 and most_gone positive, got {values}")

    def heaviest(self, mass: float) -> float:
        """Return the weight [N] up to which a load counts as one part of ``mass`` [kg].

        It lies midway between one part and two, or higher where the sensor would take one part for two too often.
        """
        return GRAVITY * mass + max(0.5 * GRAVITY * mass, self.deviations * self.force.deviation(self.readings))

    def undecided(self, mass: float, weight: float) -> bool:
        """Tell whether a ``weight`` [N] may be that of one part of ``mass`` [kg] as well as of two.

        It never may where the sensor's error is small against the part's weight.
        """
        error = self.sure * self.force.deviation(self.readings)
        return 2 * GRAVITY * mass - error < weight < GRAVITY * mass + error


class LoadCheck:
    """Measures the load of one attempt, from the closing of the jaw on."""

    def __init__(
        self,
        simulation: Simulation,
        gripper: GripperModel,
        width: float,
        settings: DoubleSettings,
        sensor: WristForceSensor,
    ) -> None:
        """Tare the sensor.

        Args:
            simulation: The cell, of which only jaw, tcp and wrist force are read, but for the true number of parts.
            gripper: Distance between the pads at each position of the jaw.
            width: Distance between the pads in the grasp [m].
            settings: Thresholds.
            sensor: Force sensor of the wrist.
        """
        self._simulation, self._gripper, self._width = simulation, gripper, width
        self._settings, self._sensor = settings, sensor
        self._readings: deque[tuple[float, float]] = deque(maxlen=settings.readings + 1)  # force [N], height [m]
        self._before: tuple[Floats, float] | None = None  # heights of the parts and of the tcp before the lift [m]
        self.result: DoubleCheck | None = None
        self.image_possible = False  # whether an image of the bin can be taken before the load is let go
        self.looked = False  # whether one was taken
        sensor.tare()

    def feel(self) -> None:
        """Take a reading; called after each control step of the lift."""
        height = float(self._simulation.T_world_tcp[2, 3])
        if self._before is None:
            self._before = self._simulation.part_centres()[:, 2], height
        self._readings.append((self._sensor.read(), height))

    @property
    def readings(self) -> int:
        """Number of readings that an answer needs."""
        return self._settings.readings + 1

    @property
    def weight(self) -> float:
        """Mean of the last readings [N], less what the vertical acceleration of the load adds."""
        force, height = np.array(self._readings).T
        if len(force) < 3:
            return float(force.mean())
        speed = np.diff(height) / CONTROL_PERIOD
        acceleration = (speed[-1] - speed[0]) / ((len(speed) - 1) * CONTROL_PERIOD)
        return float(force[1:].mean() * GRAVITY / max(GRAVITY + acceleration, 1.0))

    def lightened(self) -> bool:
        """Whether the last three readings are under half the weight after the lift: the load rests on something.

        They tell nothing where half the load is small against the sensor's error.
        """
        assert self.result is not None
        settings = self._settings
        half = 0.5 * self.result.load * GRAVITY * self._simulation.part.mass
        if half < settings.sure * settings.force.deviation(_LAST):
            return False
        return float(np.mean([force for force, _ in list(self._readings)[-_LAST:]])) < half

    def decide(self) -> bool:
        """Keep what was measured as ``result``; return whether there is more than one part for a reason that counts.

        It may be asked again: another part may have leaned on the load and fallen off.
        """
        settings, simulation = self._settings, self._simulation
        mass, weight = simulation.part.mass, self.weight
        excess = self._gripper.gap(simulation.gripper_position) - self._width
        measured = DoubleCheck(
            jaw_excess=excess,
            load=weight / (GRAVITY * mass),
            jaw=excess > settings.jaw_tolerance,
            weight=weight > settings.heaviest(mass),
            held=0,
        )
        self.result = replace(measured, held=self._held())
        return (measured.jaw and settings.jaw) or (measured.weight and settings.weight and not self.needs_image)

    @property
    def needs_image(self) -> bool:
        """Whether only an image of the bin, which can be taken, tells one part from two."""
        settings, mass = self._settings, self._simulation.part.mass
        if self.result is None or not (settings.image and settings.weight and self.image_possible):
            return False
        return settings.undecided(mass, self.result.load * GRAVITY * mass)

    def see(self, gone: float | None) -> bool:
        """Add to ``result`` what an image of the bin shows; return whether there is more than one part.

        Args:
            gone: Area that is gone beside the picked part, as a share of the part's mean silhouette. None if the image
                does not show the bin: the weight then decides.
        """
        assert self.result is not None
        self.looked = True
        if gone is None:
            return self.result.weight
        image = gone > self._settings.most_gone
        self.result = replace(self.result, gone=gone, image=image)
        return image

    def _held(self) -> int:
        """Return the true number of parts that have risen with the gripper."""
        simulation = self._simulation
        if self._before is None:
            return 0
        heights, tcp = self._before
        risen = simulation.part_centres()[:, 2] - heights
        return int((simulation.in_play & (risen > _RISEN * (float(simulation.T_world_tcp[2, 3]) - tcp))).sum())
