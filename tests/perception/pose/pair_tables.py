"""Pair tables of plain arrays."""

import numpy as np

from perception.pose.model.edge_models import EdgeModel
from perception.pose.model.pair_features import build_table, usable


def table_of(points, tangents, visibility, d_max, config=None, *, symmetry=None, centre=None):
    """Return the table of edge points whose views have no direction; the centre is the points' mean if left out."""
    if centre is None:
        kept = usable(points, tangents) if np.shape(points) == np.shape(tangents) else []
        centre = points[kept].mean(axis=0) if len(kept) else np.zeros(3)
    edges = EdgeModel(
        points=points,
        tangents=tangents,
        visibility=visibility,
        views=np.array([[0.0, 0.0, 1.0]]),
        centre=centre,
        d_max=d_max,
    )
    return build_table(edges, config, symmetry)
