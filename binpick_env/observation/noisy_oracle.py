"""An oracle whose errors are drawn from a noise model fitted to the learned perceiver."""

import numpy as np

from binpick_env.candidates import PoseCandidate
from binpick_env.observation.candidate_from_pose import make_candidate
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.perception_noise import PerceptionNoise
from perception.geometry import Floats, make_transform, random_rotation, rotation_about
from perception.metrics.pose_errors import MAX_ROTATION
from perception.part import Symmetry

_TRIES = 16  # axes drawn for a large rotation; the one that remains largest modulo symmetry is taken


class NoisyOraclePerceiver:
    """Offers, misses and displaces parts, and adds false candidates, at the rates of a `PerceptionNoise`."""

    def __init__(self, noise: PerceptionNoise) -> None:
        self._noise = noise

    def perceive(
        self,
        labelled: LabelledCapture,
        rng: np.random.Generator,
        *,
        likely: bool = False,  # noqa: ARG002 - for perceivers that are unsure
    ) -> ObservedCandidates:
        """Return a candidate for each part that is not missed, and the false candidates, the highest score first."""
        visible = [int(i) for i in np.flatnonzero(labelled.visible_fractions > 0)]
        drawn = [self._candidate(labelled, i, rng) for i in visible]
        candidates = [candidate for candidate in drawn if candidate is not None]
        if visible:
            candidates += [self._false(labelled, visible, rng) for _ in range(rng.poisson(self._noise.false_rate))]
        return ObservedCandidates(candidates=sorted(candidates, key=lambda candidate: -candidate.score))

    def _candidate(self, labelled: LabelledCapture, i: int, rng: np.random.Generator) -> PoseCandidate | None:
        drawn = self._noise.draw(float(labelled.visible_fractions[i]), rng)
        if drawn is None:
            return None
        return make_candidate(
            labelled,
            displaced(labelled, labelled.T_reported_parts[i], drawn.translation, drawn.rotation, rng),
            score=drawn.score,
            visible_fraction=drawn.visible_fraction,
            fill=drawn.fill,
            part=i,
        )

    def _false(self, labelled: LabelledCapture, visible: list[int], rng: np.random.Generator) -> PoseCandidate:
        """Return a candidate with a random attitude, its centre within half a d_max of a visible part's centre."""
        near = labelled.T_reported_parts[visible[rng.integers(len(visible))]]
        T_world_part = near @ make_transform(random_rotation(rng))
        shift = rng.normal(size=3)
        shift *= 0.5 * labelled.part.d_max * rng.random() / np.linalg.norm(shift)
        T_world_part[:3, 3] = near[:3, :3] @ labelled.part.centre + near[:3, 3] + shift
        T_world_part[:3, 3] -= T_world_part[:3, :3] @ labelled.part.centre
        score = self._noise.draw_false_score(rng)
        return make_candidate(labelled, T_world_part, score=score, visible_fraction=score, fill=score)


def displaced(
    labelled: LabelledCapture, T_world_part: Floats, translation: float, rotation: float, rng: np.random.Generator
) -> Floats:
    """Return a (4, 4) pose moved by ``translation`` [m] and turned by ``rotation`` [rad] about the part's centre.

    Direction and axis are random. The rotation is chosen to differ modulo symmetry, where the symmetry allows it.
    """
    direction = rng.normal(size=3)
    turn = _rotation(labelled.part.symmetry, rotation, rng)
    T = T_world_part @ make_transform(turn, labelled.part.centre - turn @ labelled.part.centre)
    T[:3, 3] += translation * direction / np.linalg.norm(direction)
    return T


def _rotation(symmetry: Symmetry, angle: float, rng: np.random.Generator) -> Floats:
    """Return a random (3, 3) rotation in part axes by ``angle`` [rad], measured modulo symmetry."""
    axes = rng.normal(size=(_TRIES, 3))
    if symmetry.axis is not None:  # a rotation about the part's own axis changes nothing
        axes -= np.outer(axes @ symmetry.axis, symmetry.axis)
    if angle <= MAX_ROTATION:
        return rotation_about(axes[0], angle)
    rotations = [rotation_about(axis, angle) for axis in axes]
    return max(rotations, key=lambda rotation: symmetry.distance(rotation, np.eye(3)))
