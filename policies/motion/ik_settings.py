"""Settings of inverse kinematics."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class IkSettings:
    """When a solution is good enough, and how long to search for it."""

    position_tolerance: float = 3e-4  # largest distance of a solution from its target [m]
    rotation_tolerance: float = 3e-3  # largest angle between a solution and its target [rad]
    max_iterations: int = 40  # iterations of one descent
    max_step: float = 0.5  # largest change of any joint in one iteration [rad]
    restarts: int = 8  # descents from other seeds than the caller's
    near: float = 2.2  # a free solution ends the search if no joint but the last moves further than this [rad]
    rotation_cost: float = 0.3  # weight of a radian of error against a metre
    posture_cost: float = 1e-4  # weight of the pull towards the seed; biases a solution by less than 1e-6
    max_jump: float = 0.35  # largest change of any joint between two samples of a line [rad]
    line_spacing: float = 0.005  # distance between two samples of a line [m]
    avoidance_distance: float = 0.003  # distance from the cell that a descent with collision avoidance keeps [m]
    avoidance_max_step: float = 0.05  # `max_step` of such a descent, whose limit holds to first order only [rad]

    def __post_init__(self) -> None:
        for name in (
            "position_tolerance",
            "rotation_tolerance",
            "max_iterations",
            "max_step",
            "max_jump",
            "line_spacing",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if self.restarts < 0:
            raise ValueError(f"restarts must be at least 0, got {self.restarts}")
