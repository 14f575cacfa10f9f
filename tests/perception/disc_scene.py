"""A labelled scene of discs made by hand: what training and prediction are tested on."""

import numpy as np

from perception.boundary import BoundaryCloud
from perception.geometry import camera_matrix, make_transform
from perception.segmentation.scene import BoundaryScene
from perception.segmentation.surface import Surface

K = camera_matrix(600.0, 320, 240)
D_MAX = 0.08
FLOOR = 0.9  # depth [m]
CELL = D_MAX / 80 * 600.0 / FLOOR  # [px]


def disc_scene(seed: int = 0, parts: int = 6, points_each: int = 160, void: int = 20) -> BoundaryScene:
    """Return discs of 40 mm radius that float level above a floor: outlines, some container points, a surface."""
    rng = np.random.default_rng(seed)
    centres = np.column_stack([rng.uniform(-0.15, 0.15, parts), rng.uniform(-0.1, 0.1, parts), np.zeros(parts)])
    centres[:, 2] = 0.88 - 0.02 * np.arange(parts)
    angle = 2 * np.pi * np.arange(points_each) / points_each
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(points_each)]) * D_MAX / 2
    points = [centre + ring for centre in centres] + [
        np.column_stack([rng.uniform(-0.2, 0.2, void), rng.uniform(-0.15, 0.15, void), np.full(void, FLOOR)])
    ]
    ids = np.concatenate([np.repeat(np.arange(parts), points_each), np.full(void, -1)])
    cloud = np.concatenate(points)
    pixels = np.round(cloud[:, :2] / cloud[:, 2:] * 600.0 + K[:2, 2]).astype(np.int64)
    cloud = np.column_stack([(pixels - K[:2, 2]) / 600.0, np.ones(len(pixels))]) * cloud[:, 2:]
    shape = (int(240 / CELL), int(320 / CELL))
    row, column = np.mgrid[: shape[0], : shape[1]]
    depth = np.full(shape, FLOOR, np.float32)
    for centre in centres[np.argsort(-centres[:, 2])]:
        middle = (centre[:2] / centre[2] * 600.0 + K[:2, 2] + 0.5) / CELL
        inside = np.hypot(column + 0.5 - middle[0], row + 0.5 - middle[1]) < D_MAX / 2 * 600.0 / centre[2] / CELL
        depth[inside] = centre[2]
    return BoundaryScene(
        part="disc",
        d_max=D_MAX,
        boundary=BoundaryCloud(
            points_cam=cloud, tangents_cam=np.zeros_like(cloud), linearity=np.zeros(len(cloud)), pixels=pixels
        ),
        surface=Surface(depth=depth, u0=0.0, v0=0.0, cell=CELL),
        K=K,
        instance_ids=ids,
        T_cam_parts=np.array([make_transform(translation=centre) for centre in centres]).reshape(parts, 4, 4),
        centres_cam=centres,
        visible_fractions=np.ones(parts),
    )
