"""``BinPick-v0``: a robot cell that empties a bin."""

import time
from dataclasses import replace
from typing import Any, Literal, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from binpick_env.camera.correction import correct_by_bin
from binpick_env.camera.depth_camera import DepthCamera
from binpick_env.camera.sensor import sensor_model
from binpick_env.camera.shading import Light
from binpick_env.candidates import MAX_CANDIDATES, pad_candidates
from binpick_env.cell.delivery import Delivery, DeliveryEvent, DeliveryJudge
from binpick_env.cell.render import CellRenderer
from binpick_env.cell.settle import drop_and_settle
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CONTROL_PERIOD, Backend, CameraConfig, CellConfig, SensorPreset
from binpick_env.env_arguments import count_range, episode_count, thread_count
from binpick_env.env_spaces import Observation, ObsMode, action_limits, observation_boxes, observe
from binpick_env.episode import EpisodeProperties, EpisodeState, FrameState, Snapshot
from binpick_env.observation.factory import make_perceiver, resolve_noise
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.oracle import PoseNoise
from binpick_env.observation.perception_noise import PerceptionNoise
from binpick_env.options import resolve_cell
from binpick_env.part_limits import check_part, require_room
from binpick_env.parts.part import Part, resolve_part
from binpick_env.parts.unit import Unit
from binpick_env.scenes.clutter import visible_fractions
from perception.bin import Trust
from perception.geometry import Floats
from perception.runtime.threads import use_threads
from perception.segmentation.choices import NetworkName

MAX_EPISODE_STEPS = 12_000


class BinPickEnv(EpisodeProperties, gym.Env[Observation, NDArray[np.float32]], EzPickle):
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
    | `frame_age` | (1,) | time since the frame behind the candidates was taken [s] |
    | `candidates` | (32, 14) | features of the pose candidates (`binpick_env.candidates.FEATURES`), zero-padded |
    | `candidate_mask` | (32,) int8 | 1 for rows that hold a candidate |
    | `image`, `depth` | (H, W, 1) uint8 and (H, W, 1) float32 [m] | the last frame, with `obs_mode="rgbd"` only |

    A frame is taken at reset, and whenever the arm is back in its home zone, out of the camera's view, after having
    left it; `info["frame_id"]` rises with each. `env.unwrapped.look()` takes another, with fresh sensor noise, and
    `look(ahead=True)` one in place of that which is due at home.

    ## Reward
    +1 for each part delivered: released over the tray, at rest in it, and the only part that entered since the gripper
    last opened. Parts are taken out of the tray once they are judged.

    ## Starting state
    The arm at home with the gripper open; `num_parts` parts dropped in random attitudes, settled and asleep.

    ## Episode end
    Terminates when no part is left in play; truncates after 12 000 steps (480 s).

    ## Info
    Flat scalars: `success` and `is_success` (every part was delivered), `delivered`, `remaining`, `total` (parts),
    `frame_id`, `last_event` (how a part left play in this step, a `Delivery`, or empty), `time` (simulated, [s]),
    `protective_stop` (the arm pressed with over 150 N, and is held for 1 s or until an action leads away from there).
    Wall clock is kept out of it, so that two copies stay equal: see the attributes `render_time` and `perception_time`.
    The attribute `observed` has the segments and poses behind the candidates, `labelled_capture` the frame and its
    ground truth.

    ## Arguments
    | name | default | meaning |
    | --- | --- | --- |
    | `part` | `"tee"` | name of a catalogue or generated part, path to a mesh file, or a loaded `Part` |
    | `unit` | `None` | unit of a file's coordinates: `"m"`, `"mm"`, `"cm"`, `"inch"`; guessed from the part's size unless given |
    | `symmetry` | `"detect"` | `"none"` takes every rotation of the part for another pose |
    | `symmetry_tolerance` | `None` | largest deviation of a file's surface from itself under a symmetry [m]; 0.5 % of the diameter unless given |
    | `density` | `None` | density of the part [kg/m^3]; the catalogue's, or aluminium's for a file |
    | `num_parts` | `(20, 30)` | number of parts, or the range it is drawn from |
    | `perception` | `"learned"` | `"learned"` (from pixels), `"gt_masks"` (true segments) or `"oracle"` (true poses) |
    | `network` | `"grid"` | segmentation network under `"learned"`: `"grid"` (in the image plane), `"dgcnn-sgpn"` or `"dgcnn-context"` (over points) |
    | `sensor` | `"good"` | depth noise: `"none"`, `"good"`, `"harsh"`, `"stereo"`, `"tof"` |
    | `bin` | `None` | length, width and height inside the bin [m]; (0.36, 0.26, 0.12) unless given |
    | `jaw` | `None` | largest opening of the jaw [m], at most the 2F-85's 0.085; action 0 opens it that far |
    | `max_acceleration` | `None` | largest acceleration of a joint in planned motions [rad/s^2]; 8 unless given |
    | `max_jerk` | `None` | largest jerk of a joint in planned motions [rad/s^3]; no limit unless given |
    | `friction` | `None` | sliding friction coefficient of parts, bin and tray; 0.5 unless given |
    | `camera_distance` | `None` | distance of the camera from the bin's floor [m]; 0.9 unless given |
    | `width` | `None` | width of the image [px]; 1280 unless given |
    | `height` | `None` | height of the image [px]; 960 unless given |
    | `backend` | `None` | what renders the depth image: `"raster"`, `"rays"` or `"egl"`; `"raster"` unless given |
    | `hand_eye_mm` | `None` | standard deviation per axis of the error of the camera's reported position [mm]; 0 unless given |
    | `camera` | `None` | a `CameraConfig`, in place of the five options before |
    | `hand_eye_deg` | `None` | standard deviation per axis of the error of the camera's reported orientation [deg]; 0 unless given |
    | `trust` | `None` | `"bin"` corrects the camera's reported pose by the bin, which is measured in each frame; `"camera"` (the default) takes it as it is |
    | `pose_noise` | `None` | errors of the oracle's poses: a `PoseNoise`, a `PerceptionNoise`, or `"learned"` for those of the learned perceiver on this part or parts like it, under this sensor |
    | `obs_mode` | `"state"` | `"rgbd"` adds the frame's image and depth |
    | `config` | `None` | a `CellConfig`: bin, tray, robot, contacts, camera, in place of the options `bin` to `hand_eye_mm`, `hand_eye_deg` and `trust` |
    | `threads` | `None` | number of threads of the ray caster, and of torch and OpenCV in perception; one unless given, or that of `perception.runtime.use_threads` around it |
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
        obs_mode: ObsMode = "state",
        config: CellConfig | None = None,
        threads: int | None = None,
        render_mode: str | None = None,
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
        cell = {
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
            symmetry_tolerance=symmetry_tolerance,
            network=network,
            **cell,
        )
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be one of {self.metadata['render_modes']}, got {render_mode!r}")
        if obs_mode not in ("state", "rgbd"):
            raise ValueError(f"obs_mode must be 'state' or 'rgbd', got {obs_mode!r}")
        threads = thread_count(threads)
        self._num_parts = count_range(num_parts)
        self.sensor = sensor_model(sensor)
        self.config = resolve_cell(config, camera, **cell)
        self.part = resolve_part(part, unit, symmetry, density, symmetry_tolerance)
        check_part(self.part, self.config)
        require_room(self.part, self.config.bin, self._num_parts[1])
        self.workspace = self.config.bin.workspace()
        noise = resolve_noise(pose_noise, self.part, sensor, self.config.camera)
        with use_threads(threads):
            self._perceiver = make_perceiver(perception, self.part.model, self.workspace, noise, threads, network)
        self.simulation = Simulation(self.config, self.part, self._num_parts[1])
        geoms = self.simulation.part_of_geom
        self.camera = DepthCamera(self.simulation.model, self.config.camera, self.workspace, geoms, threads=threads)
        self.light: Light | None = None  # lighting of the grey image; the camera's own if None
        self.render_mode = render_mode
        self._renderer = CellRenderer(self.simulation)
        self._boxes = observation_boxes(obs_mode, self.config.camera)
        self.observation_space = cast(spaces.Space[Observation], spaces.Dict(dict(self._boxes)))
        self._low, self._high = action_limits(self.simulation.model)
        self.action_space = spaces.Box(self._low.astype(np.float32), self._high.astype(np.float32), dtype=np.float32)

    # --- Gymnasium -------------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Drop and settle a new pile. ``options={"num_parts": n}`` sets its size for this episode."""
        super().reset(seed=seed)
        count = episode_count(options, self._num_parts, self.np_random)
        drop_and_settle(self.simulation, count, self.np_random)
        self.simulation.data.time = 0.0
        self._judge = DeliveryJudge(self.simulation, CONTROL_PERIOD)
        spread, turn = self.config.camera.hand_eye, self.config.calibration.rotation
        hand_eye = self.np_random.normal(scale=spread, size=3) if spread > 0 else np.zeros(3)
        rotation = self.np_random.normal(scale=turn, size=3) if turn > 0 else np.zeros(3)
        frame = self._take_frame((hand_eye, rotation), number=0)
        self._episode = EpisodeState(total=count, hand_eye=hand_eye, frame=frame, hand_eye_rotation=rotation)
        return self._observation(), self._info([])

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by 0.04 s towards the targets of ``action``."""
        events = self.advance(action)
        reward = float(sum(event.kind is Delivery.DELIVERED for event in events))
        self._watch_home()
        if self.render_mode == "human":
            self._renderer.show()
        return self._observation(), reward, self.remaining == 0, False, self._info(events)

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
        """Number of parts in play, which are in the bin, in the gripper, or in the tray and not judged yet."""
        return int(self.simulation.in_play.sum())

    @property
    def truncated(self) -> bool:
        """Whether the episode has used up the steps that the registration allows; the wrapper truncates then."""
        return self.episode.steps >= MAX_EPISODE_STEPS

    def unjudged(self) -> frozenset[int]:
        """Return the parts that are out of the bin, held by nothing, and not judged yet."""
        return frozenset(int(i) for i in np.flatnonzero(self._judge.loose()))

    def advance(self, action: NDArray[np.float32]) -> list[DeliveryEvent]:
        """Advance as :meth:`step` does, but take no frame and observe nothing; return what left play.

        For callers that decide on frames alone: they call :meth:`look` when the arm is back.
        """
        episode = self.episode
        if np.shape(action) != (7,) or not np.all(np.isfinite(action)):
            raise ValueError(f"action must be (7,) and finite, got {action}")
        targets = np.clip(np.asarray(action, dtype=np.float64), self._low, self._high)
        self.simulation.step(targets[:6], float(targets[6]))
        events = self._judge.update(float(targets[6]))
        self._episode = replace(episode, steps=episode.steps + 1, events=(*episode.events, *events))
        return events

    def skip(self, steps: int) -> None:
        """Let the time of control steps pass in which the caller has moved the arm itself and nothing else moves."""
        if steps < 0:
            raise ValueError(f"steps must not be negative, got {steps}")
        self._episode = replace(self.episode, steps=self.episode.steps + steps)
        self.simulation.data.time += steps * CONTROL_PERIOD

    def look(self, *, likely: bool = False, ahead: bool = False) -> Observation:
        """Take another frame now, with fresh sensor noise, and return the observation.

        Args:
            likely: Whether poses that are likely but not verified become candidates as well. For a picker that found
                nothing to do in the last frame.
            ahead: Whether the frame takes the place of the one that is due when the arm is home. For an arm that is on
                its way there and out of the camera's view.
        """
        frame = self._take_frame(self.episode.reported, self.episode.frame.number + 1, likely=likely)
        self._episode = replace(self.episode, frame=frame, ahead=ahead)
        return self._observation()

    def snapshot(self) -> Snapshot:
        """Return the state of the cell for :meth:`restore`, with its last frame and its random numbers.

        Light, sensor and the camera's true position are no part of it.
        """
        return Snapshot(
            episode=self.episode,  # the first, as there is none before the first reset
            simulation=self.simulation.snapshot(),
            judge=self._judge.state(),
            random=dict(self.np_random.bit_generator.state),
            seed=self._np_random_seed,
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a state of this cell, or of another one with the same part, number of parts and settings.

        The same actions then have the same results, bit by bit, given the same perception and sensor.

        Raises:
            ValueError: The snapshot is of another cell; nothing has changed then.
        """
        self.simulation.restore(snapshot.simulation)
        self._judge = DeliveryJudge(self.simulation, CONTROL_PERIOD)
        self._judge.restore(snapshot.judge)
        self.np_random.bit_generator.state = snapshot.random
        self._np_random_seed = snapshot.seed
        self._episode = snapshot.episode

    # --- inside ----------------------------------------------------------------------------------------------------

    def _take_frame(self, hand_eye: tuple[Floats, Floats], number: int, *, likely: bool = False) -> FrameState:
        """Take a frame from a camera whose reported pose is off by an offset and a rotation vector, and perceive it."""
        simulation = self.simulation
        simulation.refresh()
        started = time.perf_counter()
        self.camera.displace(*hand_eye)
        capture = self.camera.capture(simulation.data, self.np_random, self.sensor, self.light)
        captured = time.perf_counter()
        if self.config.calibration.trust == "bin":
            capture = correct_by_bin(capture, self.workspace)
        corrected = time.perf_counter()
        poses = simulation.part_poses()
        labelled = LabelledCapture(
            capture=capture,
            workspace=self.workspace,
            part=self.part.model,
            T_world_parts=poses,
            visible_fractions=visible_fractions(capture, self.part.model.mesh, poses) * simulation.in_play,
            hand_eye=hand_eye[0],
        )
        labelled_at = time.perf_counter()
        observed = self._perceiver.perceive(labelled, self.np_random, likely=likely)
        perceived = time.perf_counter()
        candidates = observed.candidates[:MAX_CANDIDATES]
        features, mask = pad_candidates(candidates, self.workspace)
        return FrameState(
            labelled_capture=labelled,
            observed=observed,
            candidates=candidates,
            features=features,
            mask=mask,
            number=number,
            time=simulation.time,
            render_time=captured - started + labelled_at - corrected,
            perception_time=perceived - labelled_at + corrected - captured,
        )

    def _watch_home(self) -> None:
        """Take a frame when the arm is back home after having left, unless it was taken on the way."""
        self._episode, due = self.episode.with_arm_at(self.simulation.joint_positions)
        if due:
            self.look()

    def _observation(self) -> Observation:
        return observe(self.simulation, self.episode.frame, self._boxes)

    def _info(self, events: list[DeliveryEvent]) -> dict[str, Any]:
        return {
            "frame_id": self.frame_id,
            "delivered": self.delivered,
            "remaining": self.remaining,
            "total": self.total,
            "time": self.simulation.time,
            "protective_stop": self.simulation.stopped,
            "last_event": str(events[-1].kind) if events else "",
            "success": self.delivered == self.total,
            "is_success": self.delivered == self.total,
        }
