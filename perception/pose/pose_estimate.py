"""The result of pose estimation: where a part is, and how likely that is right."""

from dataclasses import dataclass, field

from perception.geometry import Floats, require_shape
from perception.pose.verification.expected_error import ExpectedError
from perception.pose.verification.mismatch import Mismatch
from perception.pose.verification.verification import Verdict


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseEstimate:
    """The estimated pose of one part.

    Attributes:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        score: Probability that the pose is right, in [0, 1].
        instance_idx: Index of the group of boundary points that the pose was found in; -1 without groups.
        visible_fraction: Estimated share of the part's camera-facing surface that is visible, in [0, 1].
        verdict: Agreement of the pose with the boundary points and the depth image.
        margin: Difference between the logit of this pose and that of the best different pose of the group; infinite
            if there is no other pose.
        score_drop: Smallest decrease of the logit when the part is rotated a little; infinite if the part's symmetry
            undoes every such rotation.
        size: Number of boundary points of the group after thinning.
        surface_score: Score that the pose would have if neither its score drop, nor its expected error, nor other poses
            with nearly the same surface counted against it, in [0, 1]; with the coefficients of the default
            configuration at least ``score``. It tells which poses are likely enough to grasp at, and is no measure of
            their accuracy: a screw whose turn about its axis cannot be seen can still be picked.
        mismatch: What only the model or only the scene has in this pose; much of it lowers both scores.
        noise: Standard deviation of the frame's depth [m]; much of it lowers both scores.
        expected_error: Standard deviations of the pose's error that follow from the noise of edges and depth; a large
            one of the rotation lowers the score.
    """

    T_cam_part: Floats
    score: float
    instance_idx: int
    visible_fraction: float
    verdict: Verdict
    margin: float
    score_drop: float
    size: int
    surface_score: float
    mismatch: Mismatch = field(default_factory=Mismatch)
    noise: float = 0.0
    expected_error: ExpectedError = field(default_factory=ExpectedError)

    def __post_init__(self) -> None:
        require_shape("T_cam_part", self.T_cam_part, (4, 4))
        for name in ("score", "surface_score"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")
