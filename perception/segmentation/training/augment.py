"""Augmentation of training scenes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats


@dataclass(frozen=True, kw_only=True)
class AugmentConfig:
    """Strength of the augmentation."""

    turn: bool = True  # rotate about the optical axis by any angle
    mirror: bool = True  # mirror half of the scenes
    scale: float = 0.05  # largest relative change of the size of a part in cells
    jitter: float = 0.002  # standard deviation of the noise on depth, in units of d_max
    patches: int = 6  # largest number of round patches whose boundary points are dropped
    patch_radius: float = 0.15  # largest radius of a patch, in units of d_max
    thinning: float = 0.3  # largest share of the boundary points that is dropped at random

    def __post_init__(self) -> None:
        for name in ("jitter", "patch_radius"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        for name in ("scale", "thinning"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"{name} must be in [0, 1), got {getattr(self, name)}")
        if self.patches < 0:
            raise ValueError(f"patches must not be negative, got {self.patches}")


NONE = AugmentConfig(turn=False, mirror=False, scale=0.0, jitter=0.0, patches=0, thinning=0.0)


def draw_turn(config: AugmentConfig, rng: np.random.Generator) -> Floats:
    """Draw a (2, 2) rotation in the image plane, or a rotation with a reflection."""
    angle = rng.uniform(0.0, 2 * np.pi) if config.turn else 0.0
    cosine, sine = np.cos(angle), np.sin(angle)
    flip = -1.0 if config.mirror and rng.random() < 0.5 else 1.0
    return np.array([[cosine * flip, -sine], [sine * flip, cosine]])


def draw_kept(
    points: NDArray[np.floating], d_max: float, config: AugmentConfig, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Draw the (N,) mask of the boundary points that are kept, by random thinning and dropped patches.

    Args:
        points: (N, 3) boundary points [m].
        d_max: Largest extent of the part [m].
        config: Strength of the augmentation.
        rng: Source of the draws.
    """
    kept: NDArray[np.bool_] = rng.random(len(points)) >= rng.uniform(0.0, config.thinning)
    for _ in range(int(rng.integers(0, config.patches + 1)) if len(points) else 0):
        centre = points[rng.integers(len(points))]
        radius = d_max * rng.uniform(0.0, config.patch_radius)
        kept &= np.einsum("ij,ij->i", points - centre, points - centre) > radius * radius
    return kept
