"""A robot's model with other things around it, without compiling the robot again."""

from copy import copy

import mujoco
import numpy as np

_GEOM = ("geom_pos", "geom_quat", "geom_size", "geom_aabb", "geom_rbound")
_BODY = ("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia")


def with_surroundings(model: mujoco.MjModel, surroundings: mujoco.MjModel, pedestal: float) -> mujoco.MjModel:
    """Return a copy of a model of robot and surroundings in which the surroundings are others.

    Kinematics and collisions are those of the model that is compiled as a whole, to the last bit. Masses that follow
    from others (``body_subtreemass``, ``dof_invweight0``) stay as they are, and matter to dynamics alone.

    Args:
        model: Model of the robot and its surroundings.
        surroundings: Model of the other surroundings alone. Bodies and geoms have the same names as in ``model``.
        pedestal: Height of the robot's base above the world's origin [m].

    Raises:
        ValueError: The surroundings have another body, or other geoms in one.
    """
    moved = copy(model)
    moved.body("base").pos[2] = pedestal
    for k in range(surroundings.nbody):
        body = moved.body(surroundings.body(k).name).id
        theirs, ours = surroundings.body_geomadr[k], moved.body_geomadr[body]
        count, nodes = int(surroundings.body_geomnum[k]), int(surroundings.body_bvhnum[k])
        names = [surroundings.geom(theirs + i).name for i in range(count)]
        if names != [moved.geom(ours + i).name for i in range(int(moved.body_geomnum[body]))]:
            raise ValueError(f"the body {moved.body(body).name!r} must have the same geoms in both models, got {names}")
        for name in _GEOM:
            getattr(moved, name)[ours : ours + count] = getattr(surroundings, name)[theirs : theirs + count]
        for name in _BODY if k > 0 else ():  # the world has none
            getattr(moved, name)[body] = getattr(surroundings, name)[k]
        # The tree of bounding boxes, by which MuJoCo finds the pairs that may touch.
        there = slice(surroundings.body_bvhadr[k], surroundings.body_bvhadr[k] + nodes)
        here = slice(moved.body_bvhadr[body], moved.body_bvhadr[body] + nodes)
        for name in ("bvh_aabb", "bvh_child", "bvh_depth"):
            getattr(moved, name)[here] = getattr(surroundings, name)[there]
        leaves = surroundings.bvh_nodeid[there]
        moved.bvh_nodeid[here] = np.where(leaves < 0, leaves, leaves - theirs + ours)
    return moved
