"""Bins worked out by hand: boxes in the bin's frame, met by the rays of a pinhole."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product

import numpy as np

from perception.frame import Frame, Workspace
from perception.geometry import Floats, camera_matrix, invert_transform, make_transform, rotation_about

SIZE = (640, 480)
K = camera_matrix(850.0, *SIZE)
INNER = np.array([0.36, 0.26, 0.12])
WALL = 0.015  # thickness of walls and floor [m]
Corner = tuple[float, float, float]
Box = tuple[Corner, Corner]  # lowest and highest corner, bin frame [m]
TABLE: Box = ((-2.0, -2.0, -0.1), (2.0, 2.0, -WALL))
FLOOR: Box = ((-2.0, -2.0, -0.1), (2.0, 2.0, 0.0))


def walls(inner: Floats = INNER, wall: float = WALL) -> list[Box]:
    """Return the floor and the walls of a bin."""
    x, y, z = (float(v) for v in inner / (2, 2, 1))
    return [
        ((-x - wall, -y - wall, -WALL), (x + wall, y + wall, 0.0)),
        ((x, -y - wall, 0.0), (x + wall, y + wall, z)),
        ((-x - wall, -y - wall, 0.0), (-x, y + wall, z)),
        ((-x, y, 0.0), (x, y + wall, z)),
        ((-x, -y - wall, 0.0), (x, -y, z)),
    ]


def blocks(count: int, seed: int = 0, *, lowest: float = 0.0, inner: Floats = INNER) -> list[Box]:
    """Return blocks of a pile that lie anywhere in the bin, below its rim."""
    rng = np.random.default_rng(seed)
    low = rng.uniform((-0.5, -0.5, 0), (0.4, 0.4, 0.5), (count, 3)) * inner
    high = np.minimum(low + rng.uniform(0.02, 0.07, (count, 3)), inner * (0.5, 0.5, 0.95))
    low[:, 2] = np.maximum(low[:, 2], lowest)
    high[:, 2] = np.maximum(high[:, 2], low[:, 2] + 0.01)
    return [(tuple(a), tuple(b)) for a, b in zip(low.tolist(), high.tolist(), strict=True)]


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """A camera over a bin."""

    T_world_bin: Floats
    T_world_cam: Floats  # true pose
    noise: float = 0.0003  # standard deviation of the depth [m]
    steepest: float = np.deg2rad(75.0)  # incidence beyond which nothing is measured [rad]
    size: tuple[int, int] = SIZE
    K: Floats = field(default_factory=lambda: K)

    def see(self, boxes: list[Box], seed: int = 0) -> Frame:
        """Return what the camera measures of boxes; its pose is the true one.

        Equal calls return the same frame, which callers must not change.
        """
        return _seen(self, tuple(boxes), seed)

    def window(self, T_bin_cam: Floats, low: Corner, high: Corner) -> tuple[slice, slice]:
        """Return the rows and columns of the image within which a box is seen: all where it reaches behind the lens."""
        corners = np.array(list(product(*zip(low, high, strict=True)))) - T_bin_cam[:3, 3]
        x, y, z = T_bin_cam[:3, :3].T @ corners.T
        if z.min() < 0.01:
            return slice(None), slice(None)
        u, v = self.K[0, 0] * x / z + self.K[0, 2], self.K[1, 1] * y / z + self.K[1, 2]
        return _within(v), _within(u)

    def off(self, frame: Frame, T_cam_other: Floats) -> Frame:
        """Return the frame of a camera that is believed to be elsewhere."""
        return replace(frame, T_world_cam=self.T_world_cam @ T_cam_other)


@lru_cache
def _seen(view: View, boxes: tuple[Box, ...], seed: int) -> Frame:
    width, height = view.size
    v, u = np.mgrid[:height, :width]
    rays = np.stack([(u - view.K[0, 2]) / view.K[0, 0], (v - view.K[1, 2]) / view.K[1, 1], np.ones(u.shape)], -1)
    T_bin_cam = invert_transform(view.T_world_bin) @ view.T_world_cam
    rays, eye = rays @ T_bin_cam[:3, :3].T, T_bin_cam[:3, 3]
    depth, cosine = np.full(u.shape, np.inf), np.ones(u.shape)
    for low, high in boxes:
        part = view.window(T_bin_cam, low, high)
        some = rays[part]
        with np.errstate(divide="ignore"):
            a, b = (np.array(low) - eye) / some, (np.array(high) - eye) / some
        entered = np.minimum(a, b)
        t, left = entered.max(axis=-1), np.maximum(a, b).min(axis=-1)
        nearer = (t <= left) & (t > 0) & (t < depth[part])
        met, axis = some[nearer], entered[nearer].argmax(axis=-1)
        depth[part][nearer] = t[nearer]
        cosine[part][nearer] = np.abs(met[np.arange(len(met)), axis]) / np.linalg.norm(met, axis=-1)
    depth += view.noise * np.random.default_rng(seed).normal(size=depth.shape)
    depth[np.isinf(depth) | (cosine < np.cos(view.steepest))] = 0.0
    grey = np.full(depth.shape, 90, np.uint8)
    return Frame(grey=grey, depth=depth.astype(np.float32), K=view.K, T_world_cam=view.T_world_cam)


def _within(pixels: Floats) -> slice:
    return slice(*np.clip([np.floor(pixels.min()) - 1, np.ceil(pixels.max()) + 2], 0, None).astype(int).tolist())


def view(yaw: float = 0.2, tilt: float = 0.05, distance: float = 0.75, **changes: object) -> View:
    """Return a camera over a bin, tilted about the bin's middle."""
    T_world_bin = make_transform(rotation_about((0, 0, 1), 0.7), (0.5, -0.1, 0.03))
    over = make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, distance))
    turn = make_transform(rotation_about((1, 0.4, 0), tilt)) @ make_transform(rotation_about((0, 0, 1), yaw))
    return replace(View(T_world_bin=T_world_bin, T_world_cam=T_world_bin @ turn @ over), **changes)


def workspace(at: View, inner: Floats = INNER) -> Workspace:
    """Return the bin of a view."""
    return Workspace(T_world_bin=at.T_world_bin, inner_size=inner)
