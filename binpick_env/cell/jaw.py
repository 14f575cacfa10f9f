"""The jaw's opening as a function of the gripper's command, measured on the model of its linkage."""

from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.robot import FINGER_PADS, GRIPPER_ACTUATOR, TCP_SITE, robot_spec
from binpick_env.config import RobotConfig
from perception.geometry import Floats

_COMMANDS = 25  # nodes of the table
_SETTLE_STEPS = 500  # per command; after 300 the linkage moves by less than 1e-5 m


def open_command(jaw: float | None) -> float:
    """Return the smallest gripper command in [0, 1] that a jaw limited to an opening of ``jaw`` [m] obeys.

    Args:
        jaw: Largest distance between the pads [m]; None for the gripper's own stroke, which needs no limit.
    """
    if jaw is None:
        return 0.0
    commands, openings = _opening_table()
    return float(np.interp(-jaw, -openings, commands))


@lru_cache(maxsize=1)
def _opening_table() -> tuple[Floats, Floats]:
    """Measure (K,) rising commands and the (K,) falling openings [m] at which the linkage comes to rest.

    Contacts are off, so that the table crosses an opening of zero instead of stopping there. Takes about half a second.
    """
    spec = robot_spec(RobotConfig())
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model = spec.compile()
    data = mujoco.MjData(model)
    actuator, tcp = model.actuator(GRIPPER_ACTUATOR).id, model.site(TCP_SITE).id
    commands = np.linspace(0.0, 1.0, _COMMANDS)
    openings = np.empty(_COMMANDS)
    for k, command in enumerate(commands):
        data.ctrl[actuator] = 255.0 * command
        mujoco.mj_step(model, data, nstep=_SETTLE_STEPS)
        closing_axis = data.site_xmat[tcp].reshape(3, 3)[:, 1]
        spans = [_span([model.geom(name).id for name in side], model, data, closing_axis) for side in FINGER_PADS]
        left, right = sorted(spans, key=lambda span: float(span[0]))
        openings[k] = right[0] - left[1]
    return commands, openings


def _span(geoms: list[int], model: mujoco.MjModel, data: mujoco.MjData, axis: Floats) -> NDArray[np.float64]:
    """Return the lowest and the highest coordinate (2,) of box geoms along a world axis (3,) [m]."""
    middle = data.geom_xpos[geoms] @ axis
    half = np.abs(np.einsum("gij,i->gj", data.geom_xmat[geoms].reshape(-1, 3, 3), axis)) * model.geom_size[geoms]
    reach = half.sum(axis=1)
    return np.array([(middle - reach).min(), (middle + reach).max()])
