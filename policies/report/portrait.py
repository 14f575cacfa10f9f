"""A picture of the whole cell: a settled bin with the arm over it."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.render import PicturePainter, look_at
from binpick_env.env import BinPickEnv
from binpick_env.options import CellOptions
from perception.geometry import Floats, make_transform, rotation_about
from perception.runtime.files import write_bytes_atomically
from policies.motion.ik import IkSolver
from policies.motion.planning_scene import PlanningScene

HOVER = 0.27  # height of the tcp above the bin's floor [m]
_MAX_STEPS = 150  # largest number of control steps of the motion over the bin; 6 s
_ARRIVED = 0.01  # largest joint error [rad] and velocity [rad/s] at which the arm has arrived
_SUPERSAMPLING = 2


def cell_picture(options: CellOptions, seed: int, width: int, height: int) -> NDArray[np.uint8]:
    """Return an (H, W, 3) uint8 RGB picture of a settled bin with the arm over it.

    Args:
        options: Part, bin and friction.
        seed: Seed of the bin.
        width: Width of the picture [px].
        height: Height of the picture [px].

    Raises:
        RuntimeError: The arm cannot reach the point over the bin.
    """
    env = BinPickEnv(options.load_part(), perception="oracle", config=options.cell())
    try:
        env.reset(seed=seed)
        _move_over_bin(env)
        x, y = env.config.bin.position
        T_world_cam = look_at(np.array([x + 1.10, y - 1.10, 1.05]), np.array([x - 0.22, y - 0.10, 0.33]))
        k = _SUPERSAMPLING
        large = PicturePainter(env.simulation).paint(T_world_cam, k * width, k * height, focal_px=1.15 * k * width)
    finally:
        env.close()
    picture = cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(picture, dtype=np.uint8)


def save_png(picture: NDArray[np.uint8], path: Path) -> None:
    """Write an (H, W, 3) uint8 RGB picture as PNG, atomically; the folder is made."""
    coded, data = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not coded:
        raise RuntimeError(f"OpenCV could not encode {path}")
    write_bytes_atomically(path, data.tobytes())


def _move_over_bin(env: BinPickEnv) -> None:
    """Step the environment until the tcp hovers over the bin's centre, looking down."""
    T_bin_tcp = make_transform(rotation_about((1, 0, 0), np.pi), (0.0, 0.0, HOVER))
    T_world_tcp: Floats = env.workspace.T_world_bin @ T_bin_tcp
    reached = IkSolver(PlanningScene(env.config)).solve_grasp(T_world_tcp, env.simulation.target)
    if not reached.ok:
        raise RuntimeError(f"the arm does not reach {T_world_tcp[:3, 3].round(3).tolist()} above the bin")
    for _ in range(_MAX_STEPS):
        env.step(np.append(reached.q, 0.0).astype(np.float32))
        still = np.max(np.abs(env.simulation.joint_velocities)) < _ARRIVED
        if still and np.max(np.abs(env.simulation.joint_positions - reached.q)) < _ARRIVED:
            return
