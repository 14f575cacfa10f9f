"""The observation pipeline behind one Protocol: from what the camera saw to pose candidates."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from binpick_env.camera.depth_camera import Capture
from binpick_env.candidates import PoseCandidate
from binpick_env.config import Perception
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.perception_noise import PerceptionNoise
from perception.frame import Workspace
from perception.geometry import Floats, rotation_about, transform_points
from perception.part import PartModel

OFFERED_FROM = 0.3  # visible_fraction from which the oracle shows a part


@dataclass(frozen=True, eq=False, kw_only=True)
class LabelledCapture:
    """What one exposure shows, with the truth beside it for the perceivers that are allowed to see it.

    Attributes:
        capture: Frame and true instance ids.
        workspace: The bin.
        part: What lies in it.
        T_world_parts: (N, 4, 4) true poses.
        visible_fractions: (N,) true, 0 for parts out of play.
        hand_eye: (3,) from the camera's true place to its reported one, world axes [m].
    """

    capture: Capture
    workspace: Workspace
    part: PartModel
    T_world_parts: Floats
    visible_fractions: NDArray[np.float64]
    hand_eye: Floats = field(default_factory=lambda: np.zeros(3))

    @cached_property
    def T_reported_parts(self) -> Floats:
        """(N, 4, 4) where the parts are by the camera's reported place: what perception can know at best."""
        moved = self.T_world_parts.copy()
        moved[:, :3, 3] += self.hand_eye
        return moved


class Perceiver(Protocol):
    """Turns a view into pose candidates."""

    def perceive(self, view: LabelledCapture, rng: np.random.Generator) -> ObservedCandidates:
        """Return the seen parts, best first, and how they were seen."""
        ...


@dataclass(frozen=True, kw_only=True)
class PoseNoise:
    """Gaussian error added to true poses.

    Attributes:
        translation: Standard deviation per axis [m].
        rotation: Standard deviation of the angle about a random axis [rad].
    """

    translation: float = 0.0
    rotation: float = 0.0

    def __post_init__(self) -> None:
        if self.translation < 0 or self.rotation < 0:
            raise ValueError(f"noise must not be negative, got {self.translation} m and {self.rotation} rad")


class OraclePerceiver:
    """True poses of the parts that are visible enough, with pose noise of a stated size where wanted.

    True by the camera's reported place: an error of the hand-eye calibration is the oracle's, too.
    """

    def __init__(self, noise: PoseNoise | None = None, offered_from: float = OFFERED_FROM) -> None:
        self._noise = noise or PoseNoise()
        self._offered_from = offered_from

    def perceive(self, view: LabelledCapture, rng: np.random.Generator) -> ObservedCandidates:
        """Return a candidate for each part of sufficient visible_fraction, the most visible first."""
        order = np.argsort(-view.visible_fractions, kind="stable")
        seen = [int(i) for i in order if view.visible_fractions[i] >= self._offered_from]
        return ObservedCandidates(candidates=[self._candidate(view, i, rng) for i in seen])

    def _candidate(self, view: LabelledCapture, i: int, rng: np.random.Generator) -> PoseCandidate:
        T_world_part = view.T_reported_parts[i].copy()
        if self._noise.translation > 0:
            T_world_part[:3, 3] += self._noise.translation * rng.normal(size=3)
        if self._noise.rotation > 0:
            turn = rotation_about(rng.normal(size=3), self._noise.rotation * rng.normal())
            # About the part's centre, so that a rotation error moves nothing but the rotation.
            arm = T_world_part[:3, :3] @ view.part.centre
            T_world_part[:3, 3] += arm - turn @ arm
            T_world_part[:3, :3] = turn @ T_world_part[:3, :3]
        fraction = float(view.visible_fractions[i])
        return make_candidate(view, T_world_part, score=1.0, visible_fraction=fraction, fill=fraction, part=i)


def make_candidate(
    view: LabelledCapture, T_world_part: Floats, *, score: float, visible_fraction: float, fill: float, part: int = -1
) -> PoseCandidate:
    """Complete a pose to a candidate with its centre and its highest point."""
    points_world = transform_points(T_world_part, np.asarray(view.part.mesh.vertices))
    return PoseCandidate(
        T_world_part=T_world_part,
        centre_world=transform_points(T_world_part, view.part.centre[None])[0],
        score=score,
        visible_fraction=visible_fraction,
        top=float(view.workspace.to_bin(points_world)[:, 2].max()),
        fill=fill,
        part=part,
    )


def make_perceiver(
    mode: str,
    part: PartModel,
    workspace: Workspace,
    noise: PoseNoise | PerceptionNoise | None = None,
    threads: int | None = None,
) -> Perceiver:
    """Build the perceiver called ``mode``.

    Args:
        mode: ``"oracle"``, true poses; ``"gt_masks"``, true segments and estimated poses; ``"learned"``, the network's.
        part: What to look for. The models of its edges and its surface take seconds the first time.
        workspace: The bin it lies in.
        noise: The oracle's: of a stated size, or errors such as the learned perceiver's.
        threads: That torch and OpenCV may use while the others look; None leaves them alone.

    Raises:
        ValueError: There is no such mode, or the part's mesh does not enclose a volume.
        WeightsError: (a ValueError) ``"learned"`` has no weights for the part; the text names the commands that make
            them and the other modes.
    """
    if mode not in get_args(Perception):
        raise ValueError(f"perception must be one of {', '.join(get_args(Perception))}, got {mode!r}")
    if mode == "oracle":
        if isinstance(noise, PerceptionNoise):
            from binpick_env.observation.noisy_oracle import NoisyOraclePerceiver

            return NoisyOraclePerceiver(noise)
        return OraclePerceiver(noise)
    # Here, since it brings the pose estimator's kernels, which the oracle does without.
    from binpick_env.observation.pixel_perceiver import gt_masks_perceiver, learned_perceiver

    build = learned_perceiver if mode == "learned" else gt_masks_perceiver
    return build(part, workspace, threads)
