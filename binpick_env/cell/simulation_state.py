"""A saved state of the physics, and the cell that it belongs to."""

import hashlib
from dataclasses import dataclass, fields

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.cell.protective_stop import Stop
from binpick_env.config import CellConfig
from perception.geometry import Floats


@dataclass(frozen=True, kw_only=True)
class Origin:
    """The cell that a state belongs to.

    Attributes:
        part: Name of the part.
        parts: Number of copies of the part in the model.
        model: MuJoCo's signature of bodies, joints and geoms.
        shapes: Hash of sizes, meshes and masses.
        config: Settings of the cell.
    """

    part: str
    parts: int
    model: int
    shapes: str
    config: CellConfig

    @classmethod
    def of(cls, model: mujoco.MjModel, config: CellConfig, part: str, parts: int) -> "Origin":
        """Return the cell that states of a model belong to."""
        shapes = hashlib.sha256()
        for values in (model.geom_size, model.mesh_vert, model.body_mass, model.body_inertia):
            shapes.update(np.ascontiguousarray(values).tobytes())
        signature = int(model.signature)
        return cls(part=part, parts=parts, model=signature, shapes=shapes.hexdigest()[:12], config=config)

    def require(self, other: "Origin") -> None:
        """Check that states of another cell are states of this one.

        Raises:
            ValueError: They are not; the text names what differs.
        """
        mine, theirs = self._facts(), other._facts()
        odd = [f"{name}: {theirs[name]} there, {mine[name]} here" for name in mine if mine[name] != theirs[name]]
        if odd:
            raise ValueError(f"the snapshot is of another cell ({'; '.join(odd)})")

    def _facts(self) -> dict[str, object]:
        settings = {each.name: getattr(self.config, each.name) for each in fields(self.config)}
        return {"part": self.part, "parts": self.parts, **settings, "model": self.model, "shapes": self.shapes}


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulationSnapshot:
    """State of a `binpick_env.cell.simulation.Simulation`.

    Attributes:
        origin: Cell that the state belongs to.
        data: State of the physics, with contacts and the solver's warm start.
        in_play: (capacity,) mask of the parts in play.
        target: (6,) last joint targets [rad].
        target_before: (6,) joint targets before the last ones [rad].
        gripper_target: Last gripper command, 0 open to 1 closed.
        stop: Protective stop that holds the arm; None where nothing does.
    """

    origin: Origin
    data: mujoco.MjData
    in_play: NDArray[np.bool_]
    target: Floats
    target_before: Floats
    gripper_target: float
    stop: Stop | None

    def __reduce__(self) -> str:
        """Refuse copying and pickling: MuJoCo's own pickling loses which bodies sleep."""
        raise TypeError("a snapshot belongs to the process that took it: it can be neither copied nor pickled")
