"""The 2F-85's geometry as a function of its opening: control, reach of the fingertips, points on its surfaces.

The linkage carries the fingertips forward by 13 mm along an arc as the jaw closes, so the tcp of a grasp depends on the
grasp's width: ``T_world_tcp = T_world_grasp @ translate(0, 0, -tip_z(width))``.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import mujoco
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from binpick_env.cell.robot import FINGER_PADS, GRIPPER, GRIPPER_ACTUATOR, TCP_SITE, robot_spec
from binpick_env.config import RobotConfig
from perception.geometry import Floats, invert_transform, transform_points

LEFT, RIGHT, PALM = 0, 1, 2  # labels of the points; the left finger is on the tcp frame's -y side
PAD_SIZE = (0.022, 0.008, 0.0375)  # extent of a pad across (x), through (y) and along (z) the finger [m]
_SETTLE_STEPS = 500  # time steps at each control; after 300 the linkage moves by less than 1e-5 m
_NODES = 25  # rows of the tables
_FINE, _MEDIUM, _COARSE = 0.0045, 0.007, 0.014  # spacing of the points on pads, lower links, upper links and palm [m]


@dataclass(frozen=True, eq=False, kw_only=True)
class GripperModel:
    """Tables over K openings, widest first, in the tcp frame (z approach, y closing).

    Attributes:
        controls: (K,) gripper action in [0, 1], 0 open, rising.
        gaps: (K,) smallest distance between the pads' faces [m], falling; below zero the real pads press on each other.
        tips: (K,) z of the fingertips' ends [m].
        points: (K, P, 3) points on the collision surfaces [m], fingertips first; a mesh collides as its convex hull.
        labels: (P,) finger or palm that each point belongs to: LEFT, RIGHT or PALM.
        pad: (P,) whether the point belongs to a pad, the only place where a part may be touched.
    """

    controls: Floats
    gaps: Floats
    tips: Floats
    points: Floats
    labels: NDArray[np.int64]
    pad: NDArray[np.bool_]

    @property
    def stroke(self) -> float:
        """Largest distance between the pads [m]."""
        return float(self.gaps[0])

    def limited_to(self, jaw: float) -> "GripperModel":
        """Return the tables of a jaw that opens no wider than ``jaw`` [m]; their first row is interpolated."""
        if not jaw > 0:
            raise ValueError(f"jaw must be positive, got {jaw}")
        if jaw >= self.stroke:
            return self
        narrower = self.gaps < jaw
        return replace(
            self,
            controls=np.append(self.control(jaw), self.controls[narrower]),
            gaps=np.append(jaw, self.gaps[narrower]),
            tips=np.append(self.tip_z(jaw), self.tips[narrower]),
            points=np.concatenate([self.hull_points(jaw)[None], self.points[narrower]]),
        )

    def control(self, gap: float) -> float:
        """Return the gripper action in [0, 1] that brings the pads ``gap`` [m] apart, clipped to the stroke."""
        return float(np.interp(-gap, -self.gaps, self.controls))

    def gap(self, control: float) -> float:
        """Return the gap [m] at a gripper action in [0, 1]."""
        return max(float(np.interp(control, self.controls, self.gaps)), 0.0)

    def tip_z(self, gap: ArrayLike) -> Floats:
        """Return z of the fingertips' ends in the tcp frame [m] for gaps [m] of any shape."""
        return np.interp(-np.asarray(gap, dtype=np.float64), -self.gaps, self.tips)

    def hull_points(self, gap: float) -> Floats:
        """Return (P, 3) points in the tcp frame on the gripper's surfaces at ``gap`` [m]."""
        node = float(np.interp(-gap, -self.gaps, np.arange(len(self.gaps), dtype=np.float64)))
        low = min(int(node), len(self.gaps) - 2)
        points: Floats = self.points[low] + (node - low) * (self.points[low + 1] - self.points[low])
        return points

    def tcp_from_grasp(self, T_a_grasp: Floats, width: Floats) -> Floats:
        """Return (N, 4, 4) ``T_a_tcp`` at which the pads meet (N, 4, 4) grasps of (N,) ``width`` [m]."""
        T_a_tcp = T_a_grasp.copy()
        T_a_tcp[..., :3, 3] -= self.tip_z(width)[..., None] * T_a_grasp[..., :3, 2]
        return T_a_tcp


@lru_cache(maxsize=8)
def gripper_model(jaw: float | None = None) -> GripperModel:
    """Return the geometry of the gripper.

    Args:
        jaw: Largest opening of the jaw [m], as in :class:`binpick_env.config.RobotConfig`; the whole stroke if None.

    Note:
        About 0.5 s for the first call of a process; deterministic.
    """
    whole = _measured()
    return whole if jaw is None else whole.limited_to(jaw)


@lru_cache(maxsize=1)
def _measured() -> GripperModel:
    """Measure the gripper by letting Menagerie's linkage come to rest at 25 controls.

    Contacts are off, so that the table crosses gap zero instead of stopping there.
    """
    model, data = _bare_gripper()
    sampled = _surface_points(model)
    actuator, tcp = model.actuator(GRIPPER_ACTUATOR).id, model.site(TCP_SITE).id
    full = model.actuator_ctrlrange[actuator, 1]
    controls = np.linspace(0.0, 1.0, _NODES)
    points, gaps, tips = [], [], []
    for control in controls:
        data.ctrl[actuator] = control * full
        mujoco.mj_step(model, data, nstep=_SETTLE_STEPS)
        R_tcp_world = data.site_xmat[tcp].reshape(3, 3).T
        moved = []
        for geom, points_geom in sampled.items():
            points_world = points_geom @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            moved.append((points_world - data.site_xpos[tcp]) @ R_tcp_world.T)
        points.append(np.concatenate(moved))
        left, right = (_pad_corners(model, data, names, tcp) for names in FINGER_PADS)
        if left[:, 1].mean() > right[:, 1].mean():
            left, right = right, left
        gaps.append(right[:, 1].min() - left[:, 1].max())
        tips.append(max(left[:, 2].max(), right[:, 2].max()))
    stacked = np.stack(points)
    pads = {model.geom(name).id for names in FINGER_PADS for name in names}
    owner = np.repeat(list(sampled), [len(p) for p in sampled.values()])
    labels = _finger_labels(model, owner, stacked[0])
    keep, order = _thin(stacked[0], labels, np.isin(owner, list(pads)))
    return GripperModel(
        controls=controls,
        gaps=np.array(gaps),
        tips=np.array(tips),
        points=np.ascontiguousarray(stacked[:, keep][:, order]),
        labels=labels[keep][order],
        pad=np.isin(owner, list(pads))[keep][order],
    )


def _bare_gripper() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Compile the robot without the arm's geometry, without gravity and without contacts."""
    spec = robot_spec(RobotConfig())
    for element in [*spec.geoms, *spec.meshes]:
        owner = element.parent.name if isinstance(element, mujoco.MjsGeom) else element.name
        if not owner.startswith(GRIPPER):
            spec.delete(element)
    spec.option.gravity = [0, 0, 0]
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model = spec.compile()
    return model, mujoco.MjData(model)


def _surface_points(model: mujoco.MjModel) -> dict[int, Floats]:
    """Return dense (N, 3) points on each collision geom's convex surface, geom frame [m], by the geom's id."""
    sampled = {}
    for geom in np.flatnonzero(model.geom_contype):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            sampled[int(geom)] = _box_points(model.geom_size[geom])
        else:
            mesh = model.geom_dataid[geom]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            hull = trimesh.convex.convex_hull(model.mesh_vert[start : start + count].astype(np.float64))
            dense, _ = trimesh.sample.sample_surface(hull, int(hull.area / 1.5e-3**2), seed=0)
            sampled[int(geom)] = np.concatenate([hull.vertices, dense])
    return sampled


def _box_points(half: Floats) -> Floats:
    """Return a grid of about 2.8 mm, corners and edges included, on the surface of a box of (3,) half sizes [m]."""
    axes = [np.linspace(-h, h, int(np.ceil(2 * h / 2.8e-3)) + 1) for h in half]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[np.any(np.isclose(np.abs(grid), half), axis=1)]


def _pad_corners(model: mujoco.MjModel, data: mujoco.MjData, names: tuple[str, ...], tcp: int) -> Floats:
    """Return (8 * boxes, 3) corners of one finger's pad boxes, tcp frame."""
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    T_world_tcp = np.eye(4)
    T_world_tcp[:3, :3], T_world_tcp[:3, 3] = data.site_xmat[tcp].reshape(3, 3), data.site_xpos[tcp]
    corners = []
    for name in names:
        geom = model.geom(name).id
        R_world_geom = data.geom_xmat[geom].reshape(3, 3)
        corners.append(signs * model.geom_size[geom] @ R_world_geom.T + data.geom_xpos[geom])
    return transform_points(invert_transform(T_world_tcp), np.concatenate(corners))


def _finger_labels(model: mujoco.MjModel, owner: NDArray[np.int64], points_open: Floats) -> NDArray[np.int64]:
    """Return (N,) LEFT, RIGHT or PALM: whatever a joint of the gripper moves belongs to the finger on its side."""
    labels = np.full(len(owner), PALM)
    for geom in np.unique(owner):
        body = model.geom_bodyid[geom]
        moving = model.body_weldid[body] != model.body_weldid[model.body(GRIPPER + "base").id]
        if moving:
            labels[owner == geom] = RIGHT if points_open[owner == geom, 1].mean() > 0 else LEFT
    return labels


def _thin(
    points: Floats, labels: NDArray[np.int64], pad: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Choose one point per voxel, fine at the tips and coarse on the palm, and order them tips first.

    Returns:
        Indices of the kept points, and the order of the kept.
    """
    depth = points[:, 2].max() - points[:, 2]
    spacing = np.where(pad, _FINE, np.where((labels != PALM) & (depth < 0.06), _MEDIUM, _COARSE))
    spacing = np.where(pad & (depth < 1e-3), 1e-3, spacing)  # the tips' ends keep their whole grid
    voxel = np.floor(points / spacing[:, None] + 0.25)
    keys = np.column_stack([labels, np.round(spacing * 1e4), voxel]).astype(np.int64)
    keep = np.sort(np.unique(keys, axis=0, return_index=True)[1])
    return keep, np.argsort(-points[keep, 2], kind="stable")
