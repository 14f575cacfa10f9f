"""The oracle that errs as the learned perceiver does, as far as a noise model tells."""

import numpy as np

from binpick_env.candidates import PoseCandidate
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.perceiver import LabelledCapture, make_candidate
from binpick_env.observation.perception_noise import PerceptionNoise
from perception.geometry import Floats, make_transform, random_rotation, rotation_about
from perception.metrics.pose_error import MAX_ROTATION
from perception.part import Symmetry

_TRIES = 16  # axes drawn for a large turn, of which the one is taken that symmetry takes the least from


class NoisyOraclePerceiver:
    """Offers, misses, displaces and invents parts at the rates of a `PerceptionNoise`."""

    def __init__(self, noise: PerceptionNoise) -> None:
        self._noise = noise

    def perceive(self, view: LabelledCapture, rng: np.random.Generator) -> ObservedCandidates:
        """Return a candidate for each part that is not missed, and the false ones, the best score first."""
        seen = [int(i) for i in np.flatnonzero(view.visible_fractions > 0)]
        drawn = [self._candidate(view, i, rng) for i in seen]
        candidates = [candidate for candidate in drawn if candidate is not None]
        if seen:
            candidates += [self._false(view, seen, rng) for _ in range(rng.poisson(self._noise.false_rate))]
        return ObservedCandidates(candidates=sorted(candidates, key=lambda candidate: -candidate.score))

    def _candidate(self, view: LabelledCapture, i: int, rng: np.random.Generator) -> PoseCandidate | None:
        fraction = float(view.visible_fractions[i])
        noise = self._noise.bin_of(fraction)
        if rng.random() >= noise.offered:
            return None
        spread = self._noise.wrong if rng.random() < noise.wrong else noise.spread
        translation, rotation, score = spread.draw(rng)
        visible = fraction + noise.visible_bias + noise.visible_sigma * rng.normal()
        return make_candidate(
            view,
            displaced(view, view.T_reported_parts[i], translation, rotation, rng),
            score=score,
            visible_fraction=float(np.clip(visible, 0.0, 1.0)),
            fill=fraction * noise.fill_ratio,
            part=i,
        )

    def _false(self, view: LabelledCapture, seen: list[int], rng: np.random.Generator) -> PoseCandidate:
        """Return a pose that is no part's: in any attitude, up to a radius from the centre of one."""
        near = view.T_reported_parts[seen[rng.integers(len(seen))]]
        T_world_part = near @ make_transform(random_rotation(rng))
        shift = rng.normal(size=3)
        shift *= 0.5 * view.part.d_max * rng.random() / np.linalg.norm(shift)
        T_world_part[:3, 3] = near[:3, :3] @ view.part.centre + near[:3, 3] + shift
        T_world_part[:3, 3] -= T_world_part[:3, :3] @ view.part.centre
        score = self._noise.draw_false_score(rng)
        return make_candidate(view, T_world_part, score=score, visible_fraction=score, fill=score)


def displaced(
    view: LabelledCapture, T_world_part: Floats, translation: float, rotation: float, rng: np.random.Generator
) -> Floats:
    """Return a (4, 4) pose moved by ``translation`` [m] and turned by ``rotation`` [rad] about the part's centre.

    Directions are drawn; the turn is one that symmetry does not take back, as far as there is one.
    """
    direction = rng.normal(size=3)
    turn = _turn(view.part.symmetry, rotation, rng)
    T = T_world_part @ make_transform(turn, view.part.centre - turn @ view.part.centre)
    T[:3, 3] += translation * direction / np.linalg.norm(direction)
    return T


def _turn(symmetry: Symmetry, angle: float, rng: np.random.Generator) -> Floats:
    """Return a (3, 3) rotation in part axes by ``angle`` [rad], modulo symmetry."""
    axes = rng.normal(size=(_TRIES, 3))
    if symmetry.axis is not None:  # about the part's own axis nothing turns
        axes -= np.outer(axes @ symmetry.axis, symmetry.axis)
    if angle <= MAX_ROTATION:
        return rotation_about(axes[0], angle)
    turns = [rotation_about(axis, angle) for axis in axes]
    return max(turns, key=lambda turn: symmetry.distance(turn, np.eye(3)))
