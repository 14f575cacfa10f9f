"""``BinPick-v0``: a robot cell that empties a bin."""

import time
from typing import Any, Literal, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from binpick_env.camera.depth_camera import Capture, DepthCamera
from binpick_env.camera.shading import Light
from binpick_env.candidates import FEATURES, MAX_CANDIDATES, PoseCandidate, pad_candidates
from binpick_env.cell.delivery import Delivery, DeliveryEvent, DeliveryJudge
from binpick_env.cell.render import CellRenderer
from binpick_env.cell.robot import HOME
from binpick_env.cell.settle import drop_and_settle
from binpick_env.cell.simulation import Simulation
from binpick_env.cell.snapshot import Snapshot
from binpick_env.config import CONTROL_PERIOD, CameraConfig, CellConfig, SensorPreset
from binpick_env.observation.factory import make_perceiver
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.oracle import PoseNoise
from binpick_env.observation.perception_noise import PerceptionNoise
from binpick_env.options import resolve_cell
from binpick_env.parts.part import Part, resolve_part
from binpick_env.parts.unit import Unit
from binpick_env.scenes.clutter import visible_fractions
from perception.frame import Frame, Workspace
from perception.geometry import Floats, quat_from_matrix

Observation = dict[str, NDArray[Any]]
MAX_EPISODE_STEPS = 12_000
_NO_RESET = "there is no frame before the first reset()"
# What an episode has beside physics, judge, random numbers and events; nothing changes it in place.
_EPISODE = (
    *("capture", "labelled_capture", "observed", "candidates", "_candidate_arrays", "render_time", "perception_time"),
    *("_frame_id", "_frame_time", "_away", "_steps", "total", "delivered", "_np_random_seed", "_hand_eye"),
)
HOME_ZONE, AWAY = 0.10, 0.25  # largest joint distance from home that counts as back, and as having left [rad]


class BinPickEnv(gym.Env[Observation, NDArray[np.float32]], EzPickle):
    """A UR5e with a parallel jaw picks identical parts out of a bin into a tray, 25 actions a second.

    ## Action space
    `Box(7,)` float32: absolute targets. They are rate-limited to the arm's velocity (180 deg/s).

    | index | meaning | range |
    | --- | --- | --- |
    | 0 to 5 | joint positions, base to wrist [rad] | -2 pi to 2 pi (elbow -pi to pi) |
    | 6 | gripper, 0 open to 1 closed; clipped where `jaw` limits the opening | 0 to 1 |

    ## Observation space
    A flat `Dict` of float32 `Box`es.

    | key | shape | meaning |
    | --- | --- | --- |
    | `joint_pos` | (6,) | [rad] |
    | `joint_vel` | (6,) | [rad/s] |
    | `gripper` | (1,) | 0 open to 1 closed, measured |
    | `tcp_pose` | (7,) | tool centre point in the world, xyz [m] and wxyz |
    | `frame_age` | (1,) | since the frame behind the candidates [s] |
    | `candidates` | (32, 14) | seen parts (`binpick_env.candidates.FEATURES`), zero-padded |
    | `candidate_mask` | (32,) int8 | 1 for rows that hold a candidate |
    | `image`, `depth` | (H, W, 1) uint8 and (H, W, 1) float32 [m] | the last frame, with `obs_mode="rgbd"` only |

    A frame is taken at reset and whenever the arm is back in its home zone, out of the camera's sight, after having
    left it; `info["frame_id"]` rises with each. `env.unwrapped.look()` takes another, with fresh sensor noise.

    ## Reward
    +1 for each part delivered: released over the tray, at rest in it, and the only part that entered since the gripper
    last opened. Judged parts are parked out of the tray.

    ## Starting state
    The arm at home with the gripper open; `num_parts` parts dropped in random attitudes, settled and asleep.

    ## Episode end
    Terminates when no part is left in play; truncates after 12 000 steps (480 s).

    ## Info
    Flat scalars: `success` and `is_success` (every part was delivered), `delivered`, `remaining`, `total` (parts),
    `frame_id`, `last_event` (how a part left play in this step, a `Delivery`, or empty), `time` (simulated, [s]).
    Wall clock is kept out of it, so that two copies stay equal: see the attributes `render_time` and `perception_time`.
    The attribute `sighting` has the segments and poses behind the candidates, `exposure` the frame and its truth.

    ## Arguments
    | name | default | meaning |
    | --- | --- | --- |
    | `part` | `"tee"` | catalogue name, path to an STL, OBJ or PLY file, or a loaded `Part` |
    | `unit` | `None` | unit of a file's coordinates: `"m"`, `"mm"`, `"cm"`, `"inch"`; guessed from the part's size unless given |
    | `symmetry` | `"detect"` | `"none"` takes every rotation of the part for another pose |
    | `density` | `None` | density of the part [kg/m^3]; the catalogue's, or aluminium's for a file |
    | `num_parts` | `(20, 30)` | number of parts, or the range it is drawn from |
    | `perception` | `"learned"` | `"learned"` (from pixels), `"gt_masks"` (true segments) or `"oracle"` (true poses) |
    | `sensor` | `"good"` | depth noise: `"none"`, `"good"`, `"harsh"` |
    | `bin` | `None` | length, width and height inside the bin [m]; (0.36, 0.26, 0.12) unless given |
    | `jaw` | `None` | largest opening of the jaw [m], at most the 2F-85's 0.085; action 0 opens it that far |
    | `friction` | `None` | sliding friction coefficient of parts, bin and tray; 0.5 unless given |
    | `camera_distance` | `None` | distance of the camera from the bin's floor [m]; 0.9 unless given |
    | `width` | `None` | width of the image [px]; 1280 unless given |
    | `height` | `None` | height of the image [px]; 960 unless given |
    | `hand_eye_mm` | `None` | standard deviation per axis of the error of the camera's reported position [mm]; 0 unless given |
    | `camera` | `None` | a `CameraConfig`, in place of the four options before |
    | `pose_noise` | `None` | the oracle's: a `PoseNoise`, a `PerceptionNoise`, or `"learned"`: errors such as the learned perceiver's of this part and sensor |
    | `obs_mode` | `"state"` | `"rgbd"` adds the frame's image and depth |
    | `config` | `None` | a `CellConfig`: bin, tray, robot, contacts, camera, in place of the options `bin` to `hand_eye_mm` |
    | `threads` | `None` | threads of the ray caster, and of torch and OpenCV in perception; all cores unless given |
    | `render_mode` | `None` | `"rgb_array"`, `"depth_array"` (the camera's view) or `"human"` (MuJoCo's viewer) |

    ## Versions
    v0: first release.
    """  # noqa: E501 - tables

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium declares it so
        "render_modes": ["human", "rgb_array", "depth_array"],
        "render_fps": round(1 / CONTROL_PERIOD),
    }

    def __init__(
        self,
        part: str | Part = "tee",
        num_parts: int | tuple[int, int] = (20, 30),
        perception: str = "learned",
        sensor: SensorPreset = "good",
        camera: CameraConfig | None = None,
        pose_noise: PoseNoise | PerceptionNoise | Literal["learned"] | None = None,
        obs_mode: Literal["state", "rgbd"] = "state",
        config: CellConfig | None = None,
        threads: int | None = None,
        render_mode: str | None = None,
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
        cell = {
            "bin": bin,
            "jaw": jaw,
            "camera_distance": camera_distance,
            "width": width,
            "height": height,
            "hand_eye_mm": hand_eye_mm,
            "friction": friction,
        }
        # A pickled copy is made anew from these; it is the same cell from its first reset(seed) on.
        EzPickle.__init__(
            self,
            part=part,
            num_parts=num_parts,
            perception=perception,
            sensor=sensor,
            camera=camera,
            pose_noise=pose_noise,
            obs_mode=obs_mode,
            config=config,
            threads=threads,
            render_mode=render_mode,
            unit=unit,
            symmetry=symmetry,
            density=density,
            **cell,
        )
        low, high = num_parts if isinstance(num_parts, tuple | list) else (int(num_parts), int(num_parts))
        if not 1 <= low <= high:
            raise ValueError(f"num_parts must be a positive number or a rising pair, got {num_parts}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be one of {self.metadata['render_modes']}, got {render_mode!r}")
        if obs_mode not in ("state", "rgbd"):
            raise ValueError(f"obs_mode must be 'state' or 'rgbd', got {obs_mode!r}")
        if threads is not None and threads < 1:
            raise ValueError(f"threads must be at least 1, got {threads}")
        self.config = resolve_cell(config, camera, **cell)
        self.part = resolve_part(part, unit, symmetry, density)
        self.workspace: Workspace = self.config.bin.workspace()
        if isinstance(pose_noise, str) and pose_noise != "learned":
            raise ValueError(f"pose_noise must be a PoseNoise, a PerceptionNoise or 'learned', got {pose_noise!r}")
        noise = PerceptionNoise.for_part(self.part.model.name, sensor) if isinstance(pose_noise, str) else pose_noise
        self._perceiver = make_perceiver(perception, self.part.model, self.workspace, noise, threads)
        self.render_mode = render_mode
        self.simulation = Simulation(self.config, self.part, high)
        self._num_parts = (low, high)
        self._sensor = sensor
        self._obs_mode = obs_mode
        geoms = self.simulation.part_of_geom
        self.camera = DepthCamera(self.simulation.model, self.config.camera, self.workspace, geoms, threads=threads)
        self.light: Light | None = None  # of the grey image, the camera's own if None
        self._renderer = CellRenderer(self.simulation)
        self.capture: Capture | None = None
        self._observed = self._observation_space()
        self.observation_space = cast(spaces.Space[Observation], self._observed)
        self._low, self._high = self._action_limits()
        self.action_space = spaces.Box(self._low.astype(np.float32), self._high.astype(np.float32), dtype=np.float32)

    # --- Gymnasium -------------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Drop and settle a new pile. ``options={"num_parts": n}`` sets its size for this episode."""
        super().reset(seed=seed)
        low, high = self._num_parts
        count = int(self.np_random.integers(low, high + 1))
        count = int((options or {}).get("num_parts", count))
        drop_and_settle(self.simulation, count, self.np_random)
        self.simulation.data.time = 0.0
        self._judge = DeliveryJudge(self.simulation, CONTROL_PERIOD)
        self.events: list[DeliveryEvent] = []
        self.total = count
        self.delivered = 0
        self._steps = 0
        self._frame_id = -1
        self._away = False
        spread = self.config.camera.hand_eye
        self._hand_eye = self.np_random.normal(scale=spread, size=3) if spread > 0 else np.zeros(3)
        self._take_frame()
        return self._observe(), self._info([])

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by 0.04 s towards the targets of ``action``."""
        events = self.advance(action)
        reward = float(sum(event.kind is Delivery.DELIVERED for event in events))
        self._watch_home()
        if self.render_mode == "human":
            self._renderer.show()
        return self._observe(), reward, self.remaining == 0, False, self._info(events)

    def render(self) -> NDArray[Any] | None:
        """Return a picture of the cell (`rgb_array`) or the camera's depth [m] (`depth_array`)."""
        if self.render_mode == "rgb_array":
            return self._renderer.picture()
        if self.render_mode == "depth_array":
            return self.camera.capture(self.simulation.data, np.random.default_rng(0), "none").frame.depth
        return None

    def close(self) -> None:
        """Release the viewer and the GL context, if there were any."""
        self._renderer.close()
        self.camera.close()

    # --- beyond Gymnasium ------------------------------------------------------------------------------------------

    @property
    def remaining(self) -> int:
        """Number of parts in play: in the bin, in the gripper, in the tray but not judged yet."""
        return int(self.simulation.in_play.sum())

    @property
    def frame(self) -> Frame:
        """The last frame."""
        if self.capture is None:
            raise RuntimeError(_NO_RESET)
        return self.capture.frame

    @property
    def frame_id(self) -> int:
        """Number of frames taken in this episode, minus one."""
        return self._frame_id

    @property
    def truncated(self) -> bool:
        """Whether the episode has used up the steps that the registration allows; the wrapper truncates then."""
        return self._steps >= MAX_EPISODE_STEPS

    def unjudged(self) -> frozenset[int]:
        """Return the parts that are out of the bin, held by nothing, and not judged yet."""
        return frozenset(int(i) for i in np.flatnonzero(self._judge.loose()))

    def advance(self, action: NDArray[np.float32]) -> list[DeliveryEvent]:
        """Advance as :meth:`step` does, but take no frame and observe nothing; return what left play.

        For those who decide on frames alone: they call :meth:`look` when the arm is back.
        """
        self._require_reset()
        if np.shape(action) != (7,) or not np.all(np.isfinite(action)):
            raise ValueError(f"action must be (7,) and finite, got {action}")
        targets = np.clip(np.asarray(action, dtype=np.float64), self._low, self._high)
        self.simulation.step(targets[:6], float(targets[6]))
        self._steps += 1
        events = self._judge.update(float(targets[6]))
        self.events.extend(events)
        self.delivered += sum(event.kind is Delivery.DELIVERED for event in events)
        return events

    def skip(self, steps: int) -> None:
        """Count control steps that somebody else brought the arm through; nothing else moves in that time."""
        if steps < 0:
            raise ValueError(f"steps must not be negative, got {steps}")
        self._steps += steps
        self.simulation.data.time += steps * CONTROL_PERIOD

    def look(self) -> Observation:
        """Take another frame now, with fresh sensor noise, and return the observation."""
        self._require_reset()
        self._take_frame()
        return self._observe()

    def snapshot(self) -> Snapshot:
        """Return the state of the cell, its last frame and its random numbers included, to go back to.

        Light, sensor and the camera's true place are the cell's own, and stay as they are.
        """
        self._require_reset()
        return Snapshot(
            simulation=self.simulation.snapshot(),
            judge=self._judge.state(),
            random=dict(self.np_random.bit_generator.state),
            events=tuple(self.events),
            episode={name: getattr(self, name) for name in _EPISODE},
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a state of this cell, or of another one of the same part, number of parts and settings.

        The same actions then bring the same results, bit by bit, given the same perception and sensor.

        Raises:
            ValueError: It is of another cell; nothing has changed then.
        """
        self.simulation.restore(snapshot.simulation)
        self._judge = DeliveryJudge(self.simulation, CONTROL_PERIOD)
        self._judge.restore(snapshot.judge)
        self.np_random.bit_generator.state = snapshot.random
        self.events = list(snapshot.events)
        for name, value in snapshot.episode.items():
            setattr(self, name, value)

    # --- inside ----------------------------------------------------------------------------------------------------

    def _require_reset(self) -> None:
        if self.capture is None:
            raise RuntimeError(_NO_RESET)

    def _take_frame(self) -> None:
        simulation = self.simulation
        simulation.refresh()
        started = time.perf_counter()
        self.camera.displace(self._hand_eye)
        self.capture = self.camera.capture(simulation.data, self.np_random, self._sensor, self.light)
        poses = simulation.part_poses()
        fractions = visible_fractions(self.capture, self.part.model.mesh, poses) * simulation.in_play
        self.labelled_capture = LabelledCapture(
            capture=self.capture,
            workspace=self.workspace,
            part=self.part.model,
            T_world_parts=poses,
            visible_fractions=fractions,
            hand_eye=self._hand_eye,
        )
        rendered = time.perf_counter()
        self.observed: ObservedCandidates = self._perceiver.perceive(self.labelled_capture, self.np_random)
        self.candidates: list[PoseCandidate] = self.observed.candidates[:MAX_CANDIDATES]
        self.render_time = rendered - started
        self.perception_time = time.perf_counter() - rendered
        self._candidate_arrays = pad_candidates(self.candidates, self.workspace)
        self._frame_id += 1
        self._frame_time = simulation.time

    def _watch_home(self) -> None:
        distance = float(np.max(np.abs(self.simulation.joint_positions - HOME)))
        if distance > AWAY:
            self._away = True
        elif distance < HOME_ZONE and self._away:
            self._away = False
            self._take_frame()

    def _observe(self) -> Observation:
        simulation = self.simulation
        T_world_tcp: Floats = simulation.T_world_tcp
        tcp_pose = np.concatenate([T_world_tcp[:3, 3], quat_from_matrix(T_world_tcp[:3, :3])])
        rows, mask = self._candidate_arrays
        values: Observation = {
            "joint_pos": simulation.joint_positions,
            "joint_vel": simulation.joint_velocities,
            "gripper": np.array([simulation.gripper_position]),
            "tcp_pose": tcp_pose,
            "frame_age": np.array([simulation.time - self._frame_time]),
            "candidates": rows.copy(),
            "candidate_mask": mask.copy(),
        }
        if self._obs_mode == "rgbd":
            values["image"] = self.frame.grey[..., None].copy()
            values["depth"] = self.frame.depth[..., None].copy()
        boxes = {k: box for k, box in self._observed.items() if isinstance(box, spaces.Box)}
        return {k: np.clip(v, boxes[k].low, boxes[k].high).astype(boxes[k].dtype) for k, v in values.items()}

    def _info(self, events: list[DeliveryEvent]) -> dict[str, Any]:
        success = self.delivered == self.total
        return {
            "frame_id": self._frame_id,
            "delivered": self.delivered,
            "remaining": self.remaining,
            "total": self.total,
            "time": self.simulation.time,
            "last_event": str(events[-1].kind) if events else "",
            "success": success,
            "is_success": success,
        }

    def _action_limits(self) -> tuple[Floats, Floats]:
        limits = self.simulation.model.actuator_ctrlrange[:6]
        return np.append(limits[:, 0], 0.0), np.append(limits[:, 1], 1.0)

    def _observation_space(self) -> spaces.Dict:
        def box(low: float, high: float, *shape: int, dtype: type = np.float32) -> spaces.Box:
            return spaces.Box(low, high, shape=shape, dtype=dtype)

        entries: dict[str, spaces.Space[Any]] = {
            "joint_pos": box(-7.0, 7.0, 6),
            "joint_vel": box(-20.0, 20.0, 6),
            "gripper": box(0.0, 1.0, 1),
            "tcp_pose": box(-3.0, 3.0, 7),
            "frame_age": box(0.0, 1e6, 1),
            "candidates": box(-10.0, 10.0, MAX_CANDIDATES, len(FEATURES)),
            "candidate_mask": box(0, 1, MAX_CANDIDATES, dtype=np.int8),
        }
        if self._obs_mode == "rgbd":
            height, width = self.config.camera.height, self.config.camera.width
            entries["image"] = box(0, 255, height, width, 1, dtype=np.uint8)
            entries["depth"] = box(0.0, 10.0, height, width, 1)
        return spaces.Dict(entries)
