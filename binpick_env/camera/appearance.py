"""What makes parts and pictures differ from the clean image: light, optics, surfaces and their wear."""

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Appearance:
    """Departures of the grey image and of the parts' surfaces from the clean image. The defaults are the clean image.

    Labels and deviations are drawn for each part from ``seed`` and the part's number, in the coordinates of the part:
    they move with it.
    """

    seed: int = 0  # seed of labels, wear and deviations; part i is drawn from (seed, i)
    part_brightness: float = 1.0  # factor on the albedo of parts
    container_brightness: float = 1.0  # factor on the albedo of everything else
    gradient: float = 0.0  # relative change of the light from the middle of the image to its edge, 0 to 1
    gradient_direction: float = 0.0  # direction in the image in which the light grows, from x towards y [rad]
    vignetting: float = 0.0  # share of light lost at the distance of half the image's width from its middle, 0 to 1
    blur: float = 0.0  # standard deviation of the Gaussian point spread function [px]
    specular: float = 0.0  # intensity of Phong's highlights on parts
    shininess: float = 30.0  # exponent of Phong's highlights
    labelled: float = 0.0  # share of parts that bear a printed label
    wear: float = 0.0  # brightening of sharp convex edges, as a share of white
    noise: float = 0.0  # standard deviation of the image noise [grey values]
    deviation: float = 0.0  # largest deviation of the parts' surfaces from CAD, along the normal [m]
    wavelength: float = 0.03  # shortest wavelength of the deviation [m]

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")
        for name in ("gradient", "vignetting", "specular", "labelled", "wear"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        for name, most in (("blur", 5.0), ("noise", 50.0), ("deviation", 0.002), ("part_brightness", 2.0)):
            if not 0 <= getattr(self, name) <= most:
                raise ValueError(f"{name} must be from 0 to {most:g}, got {getattr(self, name)}")
        if not 0 <= self.container_brightness <= 2:
            raise ValueError(f"container_brightness must be from 0 to 2, got {self.container_brightness}")
        if not (self.shininess > 0 and self.wavelength > 0):
            raise ValueError(f"shininess and wavelength must be positive, got {self.shininess} and {self.wavelength}")
        if not np.isfinite(self.gradient_direction):
            raise ValueError(f"gradient_direction must be finite, got {self.gradient_direction}")

    @property
    def is_clean(self) -> bool:
        """Whether this is the clean image; seed, direction, exponent and wavelength alone change nothing."""
        idle = {"seed", "gradient_direction", "shininess", "wavelength"}
        return all(getattr(self, f.name) == f.default for f in fields(self) if f.name not in idle)


def draw_appearance(rng: np.random.Generator) -> Appearance:
    """Draw an appearance for a training scene: a quarter of them have dark parts on a dark ground."""
    dark = rng.random() < 0.25
    low, high = (0.25, 0.5) if dark else (0.6, 1.1)
    labelled, deviates = rng.random() < 0.5, rng.random() < 0.7
    return Appearance(
        seed=int(rng.integers(2**31)),
        part_brightness=float(rng.uniform(low, high)),
        container_brightness=float(rng.uniform(low, high)),
        gradient=float(rng.uniform(0.0, 0.5)),
        gradient_direction=float(rng.uniform(0.0, 2 * np.pi)),
        vignetting=float(rng.uniform(0.0, 0.4)),
        blur=float(rng.uniform(0.0, 1.2)),
        specular=float(rng.uniform(0.0, 0.6)),
        shininess=float(np.exp(rng.uniform(np.log(8.0), np.log(80.0)))),
        labelled=float(rng.uniform(0.2, 1.0)) if labelled else 0.0,
        wear=float(rng.uniform(0.0, 0.4)),
        noise=float(rng.uniform(0.0, 4.0)),
        deviation=float(rng.uniform(0.0, 0.0005)) if deviates else 0.0,
        wavelength=float(rng.uniform(0.02, 0.06)),
    )
