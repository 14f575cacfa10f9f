"""The state of an episode: what an environment remembers beside its physics, and a snapshot of both."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from binpick_env.camera.depth_camera import Capture
from binpick_env.candidates import PoseCandidate
from binpick_env.cell.delivery import Delivery, DeliveryEvent, JudgeState
from binpick_env.cell.robot import HOME
from binpick_env.cell.simulation_state import SimulationSnapshot
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from perception.frame import Frame
from perception.geometry import Floats

HOME_ZONE, AWAY = 0.10, 0.25  # largest joint distance from home at which the arm is back, or has left [rad]


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameState:
    """The last frame of an episode, the candidates observed in it, and the time that they took.

    Attributes:
        labelled_capture: Frame and ground truth.
        observed: Pose candidates of the frame, and the perception behind them.
        candidates: The best of these candidates, as many as an observation holds.
        features: (K, F) float32 features of the candidates, zero-padded.
        mask: (K,) int8, 1 for rows of ``features`` that hold a candidate.
        number: Number of frames that were taken before in this episode.
        time: Simulated time at which the frame was taken [s].
        render_time: Wall-clock time of rendering [s].
        perception_time: Wall-clock time of perception [s].
    """

    labelled_capture: LabelledCapture
    observed: ObservedCandidates
    candidates: list[PoseCandidate]
    features: NDArray[np.float32]
    mask: NDArray[np.int8]
    number: int
    time: float
    render_time: float
    perception_time: float


@dataclass(frozen=True, eq=False, kw_only=True)
class EpisodeState:
    """Everything that an environment remembers of its episode, but physics, judge and random numbers.

    Attributes:
        total: Number of parts that were dropped into the bin.
        hand_eye: (3,) offset from the camera's true position to its reported one, world axes [m].
        hand_eye_rotation: (3,) rotation vector from its true orientation to its reported one, camera frame [rad].
        frame: Last frame.
        events: How parts left play so far, in order of time.
        steps: Number of control steps so far.
        away: Whether the arm has left its home zone since it was last there.
        ahead: Whether the last frame was taken on the arm's way home, in place of the one that is due there.
    """

    total: int
    hand_eye: Floats
    frame: FrameState
    events: tuple[DeliveryEvent, ...] = ()
    steps: int = 0
    away: bool = False
    ahead: bool = False
    hand_eye_rotation: Floats = field(default_factory=lambda: np.zeros(3))

    @property
    def reported(self) -> tuple[Floats, Floats]:
        """Offset [m] and rotation vector [rad] from the camera's true pose to its reported one."""
        return self.hand_eye, self.hand_eye_rotation

    def with_arm_at(self, joint_positions: Floats) -> tuple["EpisodeState", bool]:
        """Return the state with the arm at (6,) positions [rad], and whether a frame is due.

        It is when the arm is back home after having left, unless it was taken on the way. One that was taken at home,
        before the arm left, takes no other's place.
        """
        distance = float(np.max(np.abs(joint_positions - HOME)))
        if distance > AWAY:
            return replace(self, away=True, ahead=self.ahead and self.away), False
        if distance < HOME_ZONE and self.away:
            return replace(self, away=False, ahead=False), not self.ahead
        return self, False

    @property
    def delivered(self) -> int:
        """Number of parts that were delivered."""
        return sum(event.kind is Delivery.DELIVERED for event in self.events)


class EpisodeProperties:
    """The state of the current episode, as properties. All raise a `RuntimeError` before the first reset."""

    _episode: EpisodeState | None = None

    @property
    def episode(self) -> EpisodeState:
        """State of the current episode."""
        if self._episode is None:
            raise RuntimeError("there is no frame before the first reset()")
        return self._episode

    def expect_frame(self) -> None:
        """Have a frame taken when the arm is home next, whatever was taken on its way there before."""
        self._episode = replace(self.episode, ahead=False)

    @property
    def total(self) -> int:
        """Number of parts that were dropped into the bin."""
        return self.episode.total

    @property
    def delivered(self) -> int:
        """Number of parts that were delivered."""
        return self.episode.delivered

    @property
    def events(self) -> list[DeliveryEvent]:
        """How parts left play so far, in order of time."""
        return list(self.episode.events)

    @property
    def frame_id(self) -> int:
        """Number of frames that were taken before the last one in this episode."""
        return self.episode.frame.number

    @property
    def frame(self) -> Frame:
        """The last frame."""
        return self.capture.frame

    @property
    def capture(self) -> Capture:
        """The last frame with the ground truth of its pixels."""
        return self.labelled_capture.capture

    @property
    def labelled_capture(self) -> LabelledCapture:
        """The last frame with the ground truth of its pixels and its parts."""
        return self.episode.frame.labelled_capture

    @property
    def observed(self) -> ObservedCandidates:
        """Pose candidates that perception found in the last frame, and the segments and poses behind them."""
        return self.episode.frame.observed

    @property
    def candidates(self) -> list[PoseCandidate]:
        """Pose candidates of the last frame, best first, as many as an observation holds."""
        return self.episode.frame.candidates

    @property
    def render_time(self) -> float:
        """Wall-clock time of rendering the last frame [s]."""
        return self.episode.frame.render_time

    @property
    def perception_time(self) -> float:
        """Wall-clock time of perception on the last frame [s]."""
        return self.episode.frame.perception_time


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """State of a `binpick_env.env.BinPickEnv` within an episode, from which the same actions have the same results.

    Attributes:
        simulation: State of the physics.
        judge: State of the judgement of deliveries.
        random: State of the random number generator behind sensor noise and perception.
        seed: Seed of that generator, None if it is not known.
        episode: Everything else.
    """

    simulation: SimulationSnapshot
    judge: JudgeState
    random: dict[str, Any]
    seed: int | None
    episode: EpisodeState
