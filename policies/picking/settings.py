"""Settings of the scripted picker."""

from dataclasses import dataclass, field, replace

from policies.grasping.clearance import RankSettings
from policies.grasping.pushes import PushSettings
from policies.motion.ik_settings import IkSettings
from policies.picking.execution import ExecutionSettings
from policies.picking.load_check import DoubleSettings


@dataclass(frozen=True, kw_only=True)
class PickerSettings:
    """How the picker plans. Lengths [m]."""

    rank: RankSettings = field(default_factory=RankSettings)  # which grasps are clear, and which come first
    execution: ExecutionSettings = field(default_factory=ExecutionSettings)  # times and forces of an attempt
    doubles: DoubleSettings = field(default_factory=DoubleSettings)  # more than one part in the jaw
    push: PushSettings = field(default_factory=PushSettings)  # pushes of parts without a grasp
    ik: IkSettings = field(default_factory=IkSettings)  # how long postures are searched for
    grasps_tried: int = 40  # largest number of grasps, best first, that a decision plans for before it abstains
    # share of a part's outline under higher measurements beyond which it is picked only at a second look: what lies on
    # it comes along
    most_buried: float = 0.3
    slow_lift: float = 0.05  # share of the joints' velocity limit allowed while such a part is lifted
    standoff: float = 0.06  # length of the straight approach
    approach_speed: float = 0.4  # share of the joints' velocity limit allowed on the straight approach
    carry_scale: float = 0.9  # share of velocity and acceleration limits used with a part in the jaw
    release_height: float = 0.03  # height of the carried part's lowest point above the tray's floor at the release
    # Distance between the pads under which the jaw holds nothing, as read from the jaw's position. The closing force
    # bends the linkage: with a plate of 3 mm the position reads 1 mm, and -1 mm with nothing.
    empty_gap: float = 0.0

    def __post_init__(self) -> None:
        for name in ("slow_lift", "approach_speed", "carry_scale"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in (0, 1], got {getattr(self, name)}")
        if not (self.grasps_tried >= 1 and self.most_buried >= 0 and self.standoff > 0 and self.release_height >= 0):
            values = self.grasps_tried, self.most_buried, self.standoff, self.release_height
            raise ValueError(
                "grasps_tried must be at least 1, most_buried and release_height at least 0 and standoff positive, "
                f"got {values}"
            )

    def attempts_only(self) -> "PickerSettings":
        """Return the settings for a policy that chooses attempts and learns from them.

        They have no pushes and no put-backs, and each frame is taken when the attempt before is over.
        """
        doubles, push = replace(self.doubles, put_back=False), replace(self.push, enabled=False)
        return replace(self, doubles=doubles, push=push, execution=replace(self.execution, look_ahead=False))
