"""A cell without physics and a picker that follows a script, for the tests of what is built on top of them."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import trimesh

from binpick_env.candidates import PoseCandidate
from binpick_env.observation.candidate_from_pose import make_candidate
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.scenes.clutter import ClutterStats
from perception.boundary import BoundaryCloud
from perception.frame import Frame, Workspace
from perception.geometry import Floats, camera_matrix, invert_transform, make_transform
from perception.instance import Instance
from perception.part import PartModel
from perception.pipeline import Perception
from policies.evaluation.cell import Cell
from policies.evaluation.config import EvaluationConfig
from policies.grasping.outcomes import Abstention, GraspCandidate, GraspOutcome, PickResult, PushOutcome
from policies.picking.episode import BinResult, Termination

LOOKING_DOWN = np.diag([1.0, -1.0, -1.0])
# Off the origin, so that a pose's position is not its centre's; three different sides: symmetric under half turns.
BLOCK = PartModel.from_mesh("block", trimesh.creation.box((0.05, 0.03, 0.02), make_transform(translation=(0.1, 0, 0))))
WORKSPACE = Workspace(T_world_bin=make_transform(translation=(0.5, 0.0, 0.0)), inner_size=np.array([0.36, 0.26, 0.12]))


def frame(width: int = 320, height: int = 240) -> Frame:
    """A grey plane 0.9 m under a camera at (0.5, 0, 0.9)."""
    return Frame(
        grey=np.full((height, width), 90, np.uint8),
        depth=np.full((height, width), 0.9, np.float32),
        K=camera_matrix(600.0, width, height),
        T_world_cam=make_transform(LOOKING_DOWN, (0.5, 0.0, 0.9)),
    )


def labelled_capture(fractions: Floats, part_ids: Any = -1) -> LabelledCapture:
    """A row of blocks along the world's x, the first with its centre at (0.5, 0, 0), 70 mm from centre to centre.

    ``part_ids`` are those of the image's first row of pixels; there is no part in the others.
    """
    ids = np.full((240, 320), -1, np.int64)
    ids[0] = part_ids
    seen = frame()
    capture: Any = SimpleNamespace(frame=seen, instance_ids=ids, measured_ids=ids, T_world_cam=seen.T_world_cam)
    places = [make_transform(translation=(0.4 + 0.07 * k, 0.0, 0.0)) for k in range(len(fractions))]
    return LabelledCapture(
        capture=capture,
        workspace=WORKSPACE,
        part=BLOCK,
        T_world_parts=np.array(places).reshape(-1, 4, 4),
        visible_fractions=np.asarray(fractions, np.float64),
    )


def candidate(view: LabelledCapture, part: int, error: Floats | None = None, score: float = 0.9) -> PoseCandidate:
    """The true pose of a part, moved by the (4, 4) ``error`` about the part's centre."""
    about = make_transform(translation=BLOCK.centre)
    T_world_part = view.T_world_parts[part] @ about @ (np.eye(4) if error is None else error) @ invert_transform(about)
    return make_candidate(view, T_world_part, score=score, visible_fraction=1.0, fill=1.0, part=part)


def observed(
    view: LabelledCapture, groups: list[list[int]], candidates: list[PoseCandidate], of: list[int] | None = None
) -> ObservedCandidates:
    """What was seen in ``view`` from pixels: boundary points are all pixels of the image's first row.

    ``groups`` are indices of points, best first; ``of`` is the group of each candidate, one after the other if None.
    """
    pixels = np.column_stack([np.arange(320), np.zeros(320, np.int64)])
    boundary = BoundaryCloud(
        points_cam=np.zeros((320, 3)), tangents_cam=np.zeros((320, 3)), linearity=np.zeros(320), pixels=pixels
    )
    segments = [Instance(point_idx=np.array(idx), score=0.9 - 0.1 * k) for k, idx in enumerate(groups)]
    poses: Any = [SimpleNamespace(instance_idx=k) for k in of or range(len(candidates))]
    ms = {"boundary": 20.0, "segmentation": 60.0}
    seen = Perception(boundary=boundary, segments=segments, groups=segments, poses=poses, instances=segments[:1], ms=ms)
    return ObservedCandidates(candidates=candidates, perception=seen)


def grasp(width: float = 0.03, opening: float = 0.05) -> GraspCandidate:
    """A grasp from above at (0.5, 0, 0)."""
    T = make_transform(LOOKING_DOWN, (0.5, 0.0, 0.0))
    return GraspCandidate(
        T_world_grasp=T, T_world_tcp=T, width=width, opening=opening, candidate=0, score=0.7, features={"quality": 0.5}
    )


def attempt(outcome: GraspOutcome, **facts: Any) -> PickResult:
    times = {"t_sense": 0.5, "t_compute": 0.25, "t_motion": 5.25} | facts
    success = outcome is GraspOutcome.DELIVERED
    return PickResult(outcome=outcome, grasp=grasp(), part=1, delivered=int(success), **times)


def abstain(reason: Abstention = Abstention.NO_CANDIDATE) -> PickResult:
    return PickResult(abstention=reason, t_sense=0.5, t_compute=0.1)


def pushed(ending: PushOutcome = PushOutcome.MOVED) -> PickResult:
    return PickResult(push=ending, part=1, t_sense=0.5, t_compute=0.25, t_motion=3.25)


def bin_result(*picks: PickResult, seed: int = 1, parts: int = 10, lost: int = 0) -> BinResult:
    return BinResult(
        seed=seed,
        parts_total=parts,
        delivered=sum(pick.delivered for pick in picks),
        picks=tuple(picks),
        termination=Termination.ABSTAINED,
        clutter=ClutterStats.from_fractions(np.linspace(0.0, 1.0, parts)),
        lost=lost,
    )


@dataclass
class FakeEnv:
    """Counts what is asked of it."""

    parts: int = 3
    delivered: int = 0
    lost: int = 0
    extra_frames: int = 0
    likely_frames: int = 0
    frame_id: int = -1
    truncated: bool = False
    render_time: float = 0.0
    closed: bool = False
    events: list[Any] = field(default_factory=list)
    seeds: list[int | None] = field(default_factory=list)

    @property
    def total(self) -> int:
        return self.parts

    @property
    def remaining(self) -> int:
        return self.parts - self.delivered - self.lost

    @property
    def labelled_capture(self) -> LabelledCapture:
        return labelled_capture(np.linspace(0.1, 1.0, self.parts))

    @property
    def observed(self) -> ObservedCandidates:
        """The true pose of the last part."""
        return ObservedCandidates(candidates=[candidate(self.labelled_capture, self.parts - 1)])

    @property
    def simulation(self) -> Any:
        return SimpleNamespace(in_play=np.ones(self.parts, dtype=bool))

    @property
    def frame(self) -> Frame:
        return frame()

    def reset(self, *, seed: int | None = None) -> None:
        self.seeds.append(seed)
        self.rng = np.random.default_rng(seed)
        self.delivered = self.lost = 0
        self.frame_id = 0

    def look(self, *, likely: bool = False) -> None:
        self.extra_frames += 1
        self.likely_frames += likely
        self.frame_id += 1

    def close(self) -> None:
        self.closed = True


class ScriptPicker:
    """Returns the given results in order."""

    def __init__(self, env: FakeEnv, *script: PickResult) -> None:
        self.env, self.script = env, list(script)

    def reset(self) -> None:
        pass

    def pick(self) -> PickResult:
        result = self.script.pop(0)
        result = replace(result, frame_id=self.env.frame_id)
        self.env.delivered += result.delivered
        self.env.frame_id += result.outcome is not None
        return result


class DicePicker:
    """Delivers four times out of five, by the environment's own dice."""

    def __init__(self, env: FakeEnv) -> None:
        self.env = env

    def reset(self) -> None:
        pass

    def pick(self) -> PickResult:
        success = self.env.rng.random() < 0.8
        self.env.delivered += success
        return attempt(GraspOutcome.DELIVERED if success else GraspOutcome.MISSED)


def dice_cell(config: EvaluationConfig) -> Cell:
    env = FakeEnv(parts=config.num_parts[0])
    return Cell(env, DicePicker(env))  # type: ignore[arg-type]


def broken_cell(config: EvaluationConfig) -> Cell:
    raise FloatingPointError("the physics diverged")
