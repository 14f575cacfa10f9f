"""The page of a segmented cloud: the points coloured by their instances, from three sides."""

from html import escape
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.segmentation.pictures import part_colours
from binpick_env.jobs.report_style import inline_figure, page, table
from perception.geometry import Floats
from perception.instance import labels_of
from perception.runtime.files import write_atomically
from policies.clouds.segmented_cloud import SegmentedCloud, cloud_lines

SIZE = 900  # longer side of a picture [px]
VIEWS = {"from the camera": (0.0, 0.0), "from below the image": (-60.0, 0.0), "from the right": (0.0, 60.0)}  # [deg]
LISTED = 200  # largest number of instances in the table
_PAPER, _NONE = (24, 20, 18), (105, 98, 92)  # BGR
Colours = NDArray[np.uint8]


def write_cloud_report(path: Path, cloud: SegmentedCloud, weights: str) -> None:
    """Write the page atomically, with its pictures inside.

    Args:
        path: HTML file.
        cloud: Segmented cloud.
        weights: Name of the network's weights.
    """
    name = cloud.source.path.name
    facts = " · ".join([*cloud_lines(cloud), f"d_max {1000 * cloud.source.d_max:.4g} mm", weights])
    labels = labels_of(cloud.instances, len(cloud.points_cam))
    sections = [f"<h1>{escape(name)}</h1><p>{escape(facts)}</p>", _views("Instances", cloud.points_cam, labels)]
    truth = cloud.loaded.truth()
    if truth is not None:
        sections.append(_views("Labels of the file", cloud.points_cam, truth.instance_ids))
    rows = [
        (str(k), str(len(each.point_idx)), f"{each.score:.3f}", f"{1000 * extent:.1f}")
        for k, each in enumerate(cloud.instances[:LISTED])
        for extent in [float(np.ptp(cloud.points_cam[each.point_idx], axis=0).max())]
    ]
    sections.append(f"<h2>Best first</h2>{table(('label', 'points', 'score', 'extent [mm]'), rows)}")
    write_atomically(path, page(f"binpick: {name}", "".join(sections), wide=True))


def draw_cloud(points: Floats, labels: NDArray[np.int64], turn_deg: tuple[float, float]) -> Colours:
    """Draw points in parallel projection, the nearest last.

    Args:
        points: (N, 3) points in the camera frame [m].
        labels: (N,) instance of each point, which gives its colour; -1 for none, grey.
        turn_deg: Angles by which the cloud is turned about the x axis and the y axis.

    Returns:
        (H, W, 3) uint8 BGR picture whose longer side is `SIZE`.
    """
    about_x, about_y = (
        cv2.Rodrigues(np.radians(angle) * axis)[0] for angle, axis in zip(turn_deg, np.eye(3), strict=False)
    )
    turned = (points - points.mean(axis=0)) @ (about_y @ about_x).T
    low, span = turned.min(axis=0), np.ptp(turned, axis=0)
    scale = (SIZE - 20) / max(span[:2].max(), 1e-12)
    width, height = np.ceil(scale * span[:2]).astype(int) + 20
    table_of_colours = np.vstack([part_colours(labels.max(initial=-1) + 1), [_NONE]]).astype(np.uint8)
    picture = np.full((height, width, 3), _PAPER, np.uint8)
    at = np.rint(scale * (turned[:, :2] - low[:2])).astype(int) + 10
    for i in np.argsort(-turned[:, 2], kind="stable"):
        x, y = at[i]
        picture[y : y + 2, x : x + 2] = table_of_colours[labels[i]]
    return picture


def _views(title: str, points: Floats, labels: NDArray[np.int64]) -> str:
    figures = []
    for name, turn_deg in VIEWS.items():
        _, encoded = cv2.imencode(".png", draw_cloud(points, labels, turn_deg))
        figures.append(inline_figure(encoded.tobytes(), "png", name))
    return f"<h2>{title}</h2><div class='grid two'>{''.join(figures)}</div>"
