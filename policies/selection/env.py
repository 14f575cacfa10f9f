"""``BinPickSelect-v0``: each step chooses a grasp, which the scripted picker executes."""

import time
from dataclasses import replace
from typing import Any, Literal, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from binpick_env.config import Backend, CameraConfig, CellConfig, SensorPreset
from binpick_env.env import BinPickEnv
from binpick_env.observation.oracle import PoseNoise
from binpick_env.observation.perception_noise import PerceptionNoise
from binpick_env.parts.part import Part
from binpick_env.parts.unit import Unit
from perception.bin import Trust
from perception.segmentation.choices import NetworkName
from policies.grasping.outcomes import Abstention, GraspOutcome, PickResult
from policies.picking.episode import Termination
from policies.picking.execution import Execution
from policies.picking.fast_execution import fast_pickers
from policies.picking.scripted import T_SENSE, ScriptedPicker
from policies.picking.settings import PickerSettings
from policies.selection.candidate_generator import PER_PART, ROWS, CandidateGenerator, GraspCandidates, Observation
from policies.selection.features import HIGH, LOW

MAX_EPISODE_STEPS = 200  # picks; a bin of 30 parts takes 30 to 40
DELIVERED, OTHERWISE = 1.0, -0.1  # rewards
ABSTAINED = "abstained"  # outcome of an action on an empty row


class GraspSelectionEnv(gym.Env[Observation, np.int64], EzPickle):
    """Choose a grasp candidate; the scripted picker makes the attempt, and the next frame follows.

    ## Action space
    `Discrete(32)`: the row of the grasp. `action_masks()` and `info["action_mask"]` tell which rows hold a candidate: a
    grasp that is clear of everything observed and that the arm reaches. Choosing an empty row is an abstention: nothing
    moves, the reward is -0.1, and it counts as a failure. An action outside the space raises `ValueError`.

    The motion is planned once a grasp has been chosen (10 ms, against 0.7 ms for inverse kinematics alone). About one
    plan in fifty fails: nothing moves, the row is masked out, the reward is -0.1, and it counts neither as an attempt
    nor as a failure.

    ## Observation space
    A `Dict`; empty rows are zero.

    | key | shape | meaning |
    | --- | --- | --- |
    | `grasps` | (32, 31) float32 | the best `per_part` grasps of each part, one a row |
    | `mask` | (32,) int8 | 1 for rows that hold a candidate |

    Rows are in the order of the scripted picker, which would choose row 0. The order carries no information beyond the
    feature `rank`, the scripted score, so that a policy may treat the rows as a set. The features are those of
    `policies.selection.features.FEATURES`, in that order, clipped to [-1, 1] (signed ones) or [0, 1]:

    | index | name | meaning |
    | --- | --- | --- |
    | 0 to 2 | `x`, `y`, `z` | midpoint between the fingertips at contact, bin frame; divided by half the bin's length, half its width, twice its depth |
    | 3 to 5 | `approach_x`, `approach_y`, `approach_z` | unit vector of the approach, bin frame |
    | 6 to 8 | `closing_x`, `closing_y`, `closing_z` | unit vector along which the jaw closes, bin frame, signed so that its x is not negative; with the approach, a 6-D representation of the hand's rotation |
    | 9 | `quality` | quality of the grasp on the isolated part |
    | 10 | `vertical` | 1 for an approach straight down, 0 at the largest tilt allowed |
    | 11 | `score` | perception's confidence in the part's pose |
    | 12 | `visible` | visible fraction of the part |
    | 13 | `height` | height of the part: 1 for the highest, 0 from 60 mm below it |
    | 14 | `wall` | distance of the fingertips from the nearest wall, 1 from 50 mm |
    | 15 | `clearance` | smallest clearance of the gripper: 0 at the margin, 1 from 5 mm more |
    | 16 | `opening` | share of the tried jaw openings that are at most as wide as this one |
    | 17 | `covered` | number of observed parts above this one: 0, 1/2 for one, 1 from two |
    | 18 | `buried` | share of the part's outline over which something higher was measured |
    | 19, 20 | `clearance_back`, `clearance_front` | clearance of each finger: 0 at the margin, 1 from 20 mm more; the closing direction points from back to front |
    | 21 | `clearance_palm` | clearance of the rest of the gripper: 0 at the margin, 1 from 20 mm more |
    | 22 | `width` | distance between the pads at contact, divided by the stroke |
    | 23 | `gap` | distance between the pads during the approach, divided by the stroke |
    | 24 | `top` | height of the part's highest point above the floor, divided by twice the bin's depth |
    | 25 | `offset` | distance of the part's centre from the fingertips' midpoint, divided by half its d_max |
    | 26 | `fill` | number of visible boundary points of the part, divided by P |
    | 27 | `dexterity` | smallest singular value of the arm's Jacobian at the grasp, divided by 0.3 |
    | 28 | `suspect` | 1 if an earlier attempt on this part failed |
    | 29 | `seen` | number of observed parts, divided by 32 |
    | 30 | `rank` | weighted score of the scripted picker |

    ## Reward
    +1 if the attempt delivered its part, -0.1 otherwise.

    ## Starting state
    As `BinPick-v0`: a settled pile. A second frame is taken if the first has no candidate.

    ## Episode end
    Terminates when no part is left in play (`empty`), after `max_failures` consecutive failures (`2F`), and when two
    consecutive frames have no candidate (`abstained`). The second frame has fresh sensor noise, and poses that are
    likely but not verified are candidates as well. If the first two frames of a bin have no candidate, `reset` returns
    an empty mask, because Gymnasium cannot end an episode there; whatever the first action is, nothing moves, the
    reward is 0 and the episode terminates. Truncates after 200 steps, or when the cell has used up its 12 000 control
    steps (`time`).

    ## Info
    `action_mask` ((32,) int8), `outcome` (a `GraspOutcome`; an `Abstention` if no motion was found; `abstained` for an
    empty row; empty at reset), `termination` (a `Termination`, or empty), `success` and `is_success` (every part was
    delivered), `delivered`, `remaining` and `total` (numbers of parts), `frame_id`, `time` (simulated [s]), `t_sense`
    (nominal [s], 0.5 s for each frame that this decision took) and `t_motion` (simulated [s]). Wall clock time is no
    part of it, so that two copies stay equal: the attribute `t_compute` has that of perception, ranking and planning.
    The attribute `result` is the last attempt.

    ## Arguments
    | name | default | meaning |
    | --- | --- | --- |
    | `part`, `unit`, `symmetry`, `symmetry_tolerance`, `density`, `num_parts`, `perception`, `network`, `sensor`, `pose_noise`, `threads`, `render_mode` | | as `BinPick-v0`'s |
    | `bin`, `jaw`, `max_acceleration`, `max_jerk`, `friction`, `camera_distance`, `width`, `height`, `backend`, `hand_eye_mm`, `hand_eye_deg`, `trust`, `camera`, `config` | `None` | as `BinPick-v0`'s: options of the cell one by one, its camera, or the whole cell |
    | `max_failures` | `2` | consecutive failures that end the bin; `None` for no limit |
    | `per_part` | `3` | largest number of candidates on one part |
    | `picker` | `None` | a `PickerSettings`: settings of ranking and execution; nothing is pushed or put back |
    | `fast` | `False` | leave out the physics of an arm that touches nothing, and with the oracle the shadows in the grey image: outcomes are very nearly those of the full simulation (BENCHMARK.md); `t_motion` lacks the way home |

    ## Versions
    v0: first release.
    """  # noqa: E501 - tables

    metadata: dict[str, Any] = {**BinPickEnv.metadata, "render_fps": 1}  # noqa: RUF012 - Gymnasium declares it so

    def __init__(
        self,
        part: str | Part = "tee",
        num_parts: int | tuple[int, int] = (20, 30),
        perception: str = "learned",
        sensor: SensorPreset = "good",
        camera: CameraConfig | None = None,
        pose_noise: PoseNoise | PerceptionNoise | Literal["learned"] | None = None,
        config: CellConfig | None = None,
        threads: int | None = None,
        render_mode: str | None = None,
        max_failures: int | None = 2,
        per_part: int = PER_PART,
        picker: PickerSettings | None = None,
        fast: bool = False,
        *,
        unit: Unit | None = None,
        symmetry: Literal["detect", "none"] = "detect",
        density: float | None = None,
        symmetry_tolerance: float | None = None,
        bin: tuple[float, float, float] | None = None,
        jaw: float | None = None,
        max_acceleration: float | None = None,
        max_jerk: float | None = None,
        camera_distance: float | None = None,
        width: int | None = None,
        height: int | None = None,
        backend: Backend | None = None,
        hand_eye_mm: float | None = None,
        friction: float | None = None,
        hand_eye_deg: float | None = None,
        trust: Trust | None = None,
        network: NetworkName = "grid",
    ) -> None:
        cell: dict[str, Any] = {
            "part": part,
            "num_parts": num_parts,
            "perception": perception,
            "sensor": sensor,
            "camera": camera,
            "pose_noise": pose_noise,
            "config": config,
            "threads": threads,
            "render_mode": render_mode,
            "unit": unit,
            "symmetry": symmetry,
            "density": density,
            "symmetry_tolerance": symmetry_tolerance,
            "bin": bin,
            "jaw": jaw,
            "max_acceleration": max_acceleration,
            "max_jerk": max_jerk,
            "camera_distance": camera_distance,
            "width": width,
            "height": height,
            "backend": backend,
            "hand_eye_mm": hand_eye_mm,
            "friction": friction,
            "hand_eye_deg": hand_eye_deg,
            "trust": trust,
            "network": network,
        }
        # A pickled copy is made anew from these; it is the same environment from its first reset(seed) on.
        EzPickle.__init__(self, **cell, max_failures=max_failures, per_part=per_part, picker=picker, fast=fast)
        if max_failures is not None and max_failures < 1:
            raise ValueError(f"max_failures must be at least 1, or None for never, got {max_failures}")
        self.cell = BinPickEnv(**cell)
        settings = (picker or PickerSettings()).attempts_only()
        if fast:
            self.picker, self._prober = fast_pickers(self.cell, settings, perception)
        else:
            self.picker = ScriptedPicker(self.cell, settings)
            self._prober = self.picker.with_execution(Execution)
        self.max_failures, self.per_part = max_failures, per_part
        self.render_mode = render_mode
        self._generator = CandidateGenerator(self.cell, self.picker, per_part)
        self._running = False
        self._candidates = GraspCandidates()
        self.result: PickResult | None = None  # attempt of the last decision
        self.t_sense = self.t_compute = 0.0  # times of the last decision [s]
        self._sensed = self._computed = 0.0  # times spent on the next decision so far [s]
        low, high = np.tile(LOW, (ROWS, 1)), np.tile(HIGH, (ROWS, 1))
        entries: dict[str, spaces.Space[Any]] = {
            "grasps": spaces.Box(low, high, dtype=np.float32),
            "mask": spaces.Box(0, 1, (ROWS,), dtype=np.int8),
        }
        self.observation_space = cast(spaces.Space[Observation], spaces.Dict(entries))
        self.action_space = spaces.Discrete(ROWS)

    # --- Gymnasium -------------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Drop and settle a new pile. ``options={"num_parts": n}`` sets its size for this episode."""
        super().reset(seed=seed)
        self.cell.reset(seed=seed, options=options)
        self._begin()
        return self._candidates.observation(), self._info("", None)

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Make one attempt with the grasp in row ``action``.

        Raises:
            RuntimeError: The episode is over, or has not begun.
            ValueError: The action is outside the space.
        """
        row = self._checked(action)
        self.result = None
        self.t_sense, self.t_compute = self._sensed, self._computed
        self._sensed = self._computed = 0.0
        if not self._candidates:  # neither frame of a fresh bin had a candidate
            return self._concluded("", 0.0, Termination.ABSTAINED)
        outcome = self._act(row)
        reward = DELIVERED if outcome == GraspOutcome.DELIVERED else OTHERWISE
        return self._concluded(outcome, reward, self._termination())

    def probe(self, action: np.int64) -> PickResult | Abstention:
        """Make the attempt with the grasp in row ``action``, undo it bit for bit, and return its result.

        With ``fast`` no frame is taken, which halves the time of a step from pixels.

        Raises:
            RuntimeError: The episode is over, or has not begun.
            ValueError: The row holds no grasp.
        """
        row = self._checked(action)
        if not self._candidates.mask[row]:
            raise ValueError(f"row {row} holds no grasp, only {self._candidates.valid} do")
        plan = self._prober.plan(self._candidates.grasps[row])
        if isinstance(plan, Abstention):
            return plan
        before = self.cell.snapshot()
        result = self._prober.execute(plan)
        self.cell.restore(before)
        return result

    def action_masks(self) -> NDArray[np.bool_]:
        """Return a (32,) mask of the rows that hold a candidate, under the name that MaskablePPO calls."""
        mask: NDArray[np.bool_] = self._candidates.mask.copy()
        return mask

    def render(self) -> NDArray[Any] | None:
        """Return a picture of the cell, as `BinPick-v0` does."""
        return self.cell.render()

    def close(self) -> None:
        """Release the resources of the cell."""
        self.cell.close()

    # --- inside ----------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Start an episode on the present pile and its last frame."""
        self.picker.reset()
        self.result = None
        self.t_sense = self.t_compute = self._sensed = self._computed = 0.0
        self._failures = 0
        self._retaken = False
        self._running = True
        self._generate()
        if not self._candidates:
            self._retake_frame()

    def _checked(self, action: np.int64) -> int:
        if not self._running:
            raise RuntimeError("the episode is over, or has not begun: call reset()")
        if not self.action_space.contains(action):
            rows = f"an integer from 0 to {ROWS - 1}, of which {self._candidates.valid} hold a grasp now"
            raise ValueError(f"action must be {rows}, got {action!r}")
        return int(action)

    def _act(self, row: int) -> str:
        """Make the attempt in ``row`` if it holds a candidate and has a plan; return its outcome."""
        if not self._candidates.mask[row]:
            self._failures += 1
            return ABSTAINED
        started = time.perf_counter()
        plan = self.picker.plan(self._candidates.grasps[row])
        self.t_compute += time.perf_counter() - started
        if isinstance(plan, Abstention):
            self._candidates = self._candidates.without(row)
            return str(plan)
        result = self.picker.execute(plan)
        self.t_compute += result.t_compute
        self.result = replace(result, t_sense=self.t_sense, t_compute=self.t_compute)
        self._failures = 0 if result.success else self._failures + 1
        self._retaken = False
        return str(result.outcome)

    def _termination(self) -> Termination | None:
        """Return why the episode is over; None leaves at least one candidate."""
        if self.cell.remaining == 0:
            return Termination.EMPTY
        if self.cell.truncated:
            return Termination.TIME
        if self.max_failures is not None and self._failures >= self.max_failures:
            return Termination.TWO_FAILURES
        if self.result is not None:
            self._generate()
        if not self._candidates and not self._retaken:
            self._retake_frame()
        return None if self._candidates else Termination.ABSTAINED

    def _retake_frame(self) -> None:
        self._retaken = True
        self.cell.look(likely=True)
        self._generate()

    def _generate(self) -> None:
        started = time.perf_counter()
        self._candidates = self._generator.generate()
        self._sensed += T_SENSE
        self._computed += self.cell.perception_time + time.perf_counter() - started

    def _concluded(
        self, outcome: str, reward: float, termination: Termination | None
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        if termination is not None:
            self._running = False
            self._candidates = GraspCandidates()
            self.t_sense, self.t_compute = self.t_sense + self._sensed, self.t_compute + self._computed
        truncated = termination is Termination.TIME
        terminated = termination is not None and not truncated
        return self._candidates.observation(), reward, terminated, truncated, self._info(outcome, termination)

    def _info(self, outcome: str, termination: Termination | None) -> dict[str, Any]:
        cell = self.cell
        success = cell.delivered == cell.total
        return {
            "action_mask": self._candidates.mask.astype(np.int8),
            "outcome": outcome,
            "termination": "" if termination is None else str(termination),
            "success": success,
            "is_success": success,
            "delivered": cell.delivered,
            "remaining": cell.remaining,
            "total": cell.total,
            "frame_id": cell.frame_id,
            "time": cell.simulation.time,
            "t_sense": self.t_sense,
            "t_motion": 0.0 if self.result is None else self.result.t_motion,
        }
