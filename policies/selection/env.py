"""``BinPickSelect-v0``: one pick a step. Which grasp next? The scripted picker executes."""

import time
from dataclasses import replace
from typing import Any, Literal, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from binpick_env.config import CameraConfig, CellConfig, SensorPreset
from binpick_env.env import BinPickEnv
from binpick_env.observation.oracle import PoseNoise
from binpick_env.observation.perception_noise import PerceptionNoise
from binpick_env.parts.part import Part
from binpick_env.parts.unit import Unit
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
ABSTAINED = "abstained"  # outcome of an action on a row that holds nothing


class GraspSelectionEnv(gym.Env[Observation, np.int64], EzPickle):
    """Choose a grasp; the scripted picker makes the attempt and brings the next frame.

    ## Action space
    `Discrete(32)`: the row of the grasp. `action_masks()` and `info["action_mask"]` tell which rows hold one: it is
    clear of everything that was seen, and the arm reaches it. A row that holds none is an abstention: nothing moves,
    the reward is -0.1, and it counts as a failure. An action out of the space raises `ValueError`.

    The motion is planned when the grasp has been chosen (10 ms, against 0.7 ms for reach alone). One time in fifty there
    is none: nothing moves, the row is masked out, the reward is -0.1, and it counts as no attempt and no failure.

    ## Observation space
    A `Dict`, zero where a row holds nothing.

    | key | shape | meaning |
    | --- | --- | --- |
    | `grasps` | (32, 31) float32 | the best `per_part` grasps of each part, one a row |
    | `mask` | (32,) int8 | 1 for rows that hold a grasp |

    Rows stand in the scripted picker's order: row 0 is what it would choose. They say nothing beyond their features, of
    which `rank` is the scripted score; a policy may treat them as a set. The features, in the order of
    `policies.selection.features.FEATURES`, clipped to [-1, 1] (signed ones) or [0, 1]:

    | index | name | meaning |
    | --- | --- | --- |
    | 0 to 2 | `x`, `y`, `z` | midpoint between the fingertips at contact, bin frame; over half the bin's length, half its width, twice its depth |
    | 3 to 5 | `approach_x`, `approach_y`, `approach_z` | unit vector of the approach, bin frame |
    | 6 to 8 | `closing_x`, `closing_y`, `closing_z` | unit vector along which the jaw closes, bin frame, turned so that its x is not negative; with the approach the hand's 6-D rotation |
    | 9 | `quality` | of the grasp on the lone part |
    | 10 | `vertical` | 1 for an approach straight down, 0 at the largest tilt allowed |
    | 11 | `score` | perception's confidence in the part's pose |
    | 12 | `visible` | visible fraction of the part |
    | 13 | `height` | 1 for the highest part, 0 from 60 mm below it |
    | 14 | `wall` | distance of the fingertips to the nearest wall, 1 from 50 mm |
    | 15 | `clearance` | smallest of the gripper: 0 at the margin, 1 from 5 mm more |
    | 16 | `opening` | share of the openings that are as wide or narrower |
    | 17 | `covered` | known parts above this one, 1 from two |
    | 18 | `buried` | share of the part's outline over which something higher was measured |
    | 19, 20 | `clearance_back`, `clearance_front` | of the two fingers, 0 at the margin, 1 from 20 mm more; back is where the closing direction comes from |
    | 21 | `clearance_palm` | of the rest of the gripper |
    | 22 | `width` | between the pads at contact, over the stroke |
    | 23 | `gap` | between the pads on the way in, over the stroke |
    | 24 | `top` | the part's highest point above the floor, over twice the bin's depth |
    | 25 | `offset` | distance of the part's centre from the fingertips' midpoint, over half its d_max |
    | 26 | `fill` | visible boundary points of the part over P |
    | 27 | `dexterity` | smallest singular value of the arm's Jacobian in the grasp, over 0.3 |
    | 28 | `suspect` | 1 if an attempt on this part failed before |
    | 29 | `seen` | parts seen, over 32 |
    | 30 | `rank` | the scripted picker's weighted score |

    ## Reward
    +1 if the attempt delivered its part, -0.1 otherwise.

    ## Starting state
    As `BinPick-v0`: a settled pile, seen once, or twice if the first frame offers nothing.

    ## Episode end
    Terminates when no part is left in play (`empty`), after `max_failures` failures in a row (`2F`), and when two frames
    in a row offer nothing (`abstained`): the second is one more look, with fresh sensor noise. Where that happens to a
    fresh bin already, `reset` returns an empty mask, because Gymnasium has no way to end an episode there; whatever the
    first action is, nothing moves, the reward is 0 and the episode terminates. Truncates after 200 steps, or when the
    cell has used up its 12 000 control steps (`time`).

    ## Info
    `action_mask` ((32,) int8), `outcome` (a `GraspOutcome`; an `Abstention` if there was no motion; `abstained` for a row
    that held nothing; empty at reset), `termination` (a `Termination`, or empty), `success` and `is_success` (every part
    was delivered), `delivered`, `remaining`, `total` (parts), `frame_id`, `time` (simulated [s]), `t_sense` (nominal,
    0.5 s for each frame this decision took) and `t_motion` (simulated) [s]. Wall clock is kept out of it, so that two
    copies stay equal: the attribute `t_compute` has perception, ranking, planning. The attribute `result` is the attempt.

    ## Arguments
    | name | default | meaning |
    | --- | --- | --- |
    | `part`, `unit`, `symmetry`, `density`, `num_parts`, `perception`, `sensor`, `pose_noise`, `threads`, `render_mode` | | as `BinPick-v0`'s |
    | `bin`, `jaw`, `friction`, `camera_distance`, `width`, `height`, `hand_eye_mm`, `camera`, `config` | `None` | as `BinPick-v0`'s: options of the cell one by one, its camera, or the whole cell |
    | `max_failures` | `2` | failures in a row that end the bin; `None` for never |
    | `per_part` | `3` | at most so many grasps of each part |
    | `picker` | `None` | `PickerSettings` of the ranking and the execution |
    | `fast` | `False` | leave out the physics of an arm that touches nothing, and with the oracle the grey image's shadows: outcomes are very nearly those of the full simulation (BENCHMARK.md), `t_motion` lacks the way home |

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
        bin: tuple[float, float, float] | None = None,
        jaw: float | None = None,
        camera_distance: float | None = None,
        width: int | None = None,
        height: int | None = None,
        hand_eye_mm: float | None = None,
        friction: float | None = None,
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
            "bin": bin,
            "jaw": jaw,
            "camera_distance": camera_distance,
            "width": width,
            "height": height,
            "hand_eye_mm": hand_eye_mm,
            "friction": friction,
        }
        # A pickled copy is made anew from these; it is the same environment from its first reset(seed) on.
        EzPickle.__init__(self, **cell, max_failures=max_failures, per_part=per_part, picker=picker, fast=fast)
        if max_failures is not None and max_failures < 1:
            raise ValueError(f"max_failures must be at least 1, or None for never, got {max_failures}")
        self.cell = BinPickEnv(**cell)
        if fast:
            self.picker, self._prober = fast_pickers(self.cell, picker, perception)
        else:
            self.picker = ScriptedPicker(self.cell, picker)
            self._prober = self.picker.with_execution(Execution)
        self.max_failures, self.per_part = max_failures, per_part
        self.render_mode = render_mode
        self._menu = CandidateGenerator(self.cell, self.picker, per_part)
        self._running = False
        self._offer = GraspCandidates()
        self.result: PickResult | None = None  # the last decision's attempt
        self.t_sense = self.t_compute = 0.0  # of the last decision [s]
        self._sensed = self._computed = 0.0  # spent on the next one so far [s]
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
        return self._offer.observation(), self._info("", None)

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Make one attempt with the grasp in row ``action``.

        Raises:
            RuntimeError: The episode is over, or has not begun.
            ValueError: The action is out of the space.
        """
        row = self._checked(action)
        self.result = None
        self.t_sense, self.t_compute = self._sensed, self._computed
        self._sensed = self._computed = 0.0
        if not self._offer:  # as reset found it
            return self._concluded("", 0.0, Termination.ABSTAINED)
        outcome = self._act(row)
        reward = DELIVERED if outcome == GraspOutcome.DELIVERED else OTHERWISE
        return self._concluded(outcome, reward, self._termination())

    def probe(self, action: np.int64) -> PickResult | Abstention:
        """Make the attempt with the grasp in row ``action``, undo it to the bit, and return what came of it.

        Fast, it costs no frame, half the time of a step from pixels.

        Raises:
            RuntimeError: The episode is over, or has not begun.
            ValueError: The row holds no grasp.
        """
        row = self._checked(action)
        if not self._offer.mask[row]:
            raise ValueError(f"row {row} holds no grasp, only {self._offer.valid} do")
        plan = self._prober.plan(self._offer.grasps[row])
        if isinstance(plan, Abstention):
            return plan
        before = self.cell.snapshot()
        result = self._prober.execute(plan)
        self.cell.restore(before)
        return result

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the (32,) rows that hold a grasp; sb3-contrib's MaskablePPO asks for them by this name."""
        mask: NDArray[np.bool_] = self._offer.mask.copy()
        return mask

    def render(self) -> NDArray[Any] | None:
        """Return a picture of the cell, as `BinPick-v0` does."""
        return self.cell.render()

    def close(self) -> None:
        """Release what the cell holds."""
        self.cell.close()

    # --- inside ----------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Start on the pile as it lies, with the frame that was taken of it."""
        self.picker.reset()
        self.result = None
        self.t_sense = self.t_compute = self._sensed = self._computed = 0.0
        self._failures = 0
        self._looked_again = False
        self._running = True
        self._write_offer()
        if not self._offer:
            self._look_again()

    def _checked(self, action: np.int64) -> int:
        if not self._running:
            raise RuntimeError("the episode is over, or has not begun: call reset()")
        if not self.action_space.contains(action):
            rows = f"an integer from 0 to {ROWS - 1}, of which {self._offer.valid} hold a grasp now"
            raise ValueError(f"action must be {rows}, got {action!r}")
        return int(action)

    def _act(self, row: int) -> str:
        """Make the attempt, if there is one to make, and return what came of it."""
        if not self._offer.mask[row]:
            self._failures += 1
            return ABSTAINED
        started = time.perf_counter()
        plan = self.picker.plan(self._offer.grasps[row])
        self.t_compute += time.perf_counter() - started
        if isinstance(plan, Abstention):
            self._offer = self._offer.without(row)
            return str(plan)
        result = self.picker.execute(plan)
        self.t_compute += result.t_compute
        self.result = replace(result, t_sense=self.t_sense, t_compute=self.t_compute)
        self._failures = 0 if result.success else self._failures + 1
        self._looked_again = False
        return str(result.outcome)

    def _termination(self) -> Termination | None:
        """Return why the episode is over; if it is not, there is an offer."""
        if self.cell.remaining == 0:
            return Termination.EMPTY
        if self.cell.truncated:
            return Termination.TIME
        if self.max_failures is not None and self._failures >= self.max_failures:
            return Termination.TWO_FAILURES
        if self.result is not None:
            self._write_offer()
        if not self._offer and not self._looked_again:
            self._look_again()
        return None if self._offer else Termination.ABSTAINED

    def _look_again(self) -> None:
        self._looked_again = True
        self.cell.look()
        self._write_offer()

    def _write_offer(self) -> None:
        started = time.perf_counter()
        self._offer = self._menu.offer()
        self._sensed += T_SENSE
        self._computed += self.cell.perception_time + time.perf_counter() - started

    def _concluded(
        self, outcome: str, reward: float, termination: Termination | None
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        if termination is not None:
            self._running = False
            self._offer = GraspCandidates()
            self.t_sense, self.t_compute = self.t_sense + self._sensed, self.t_compute + self._computed
        truncated = termination is Termination.TIME
        terminated = termination is not None and not truncated
        return self._offer.observation(), reward, terminated, truncated, self._info(outcome, termination)

    def _info(self, outcome: str, termination: Termination | None) -> dict[str, Any]:
        cell = self.cell
        success = cell.delivered == cell.total
        return {
            "action_mask": self._offer.mask.astype(np.int8),
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
