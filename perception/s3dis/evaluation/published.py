"""The paper's Table 1 as printed, and our rows beside it.

"A Convolutional Neural Network for Point Cloud Instance Segmentation in Cluttered Scene Trained by Synthetic Data
Without Color" (2020), section IV-A: trained on S3DIS without Area 5, tested on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.s3dis.data.categories import SCORED
from perception.s3dis.scoring import S3disScores

SOURCE = "Table 1 of the paper (S3DIS, Area 5, AP at IoU 0.5)"


@dataclass(frozen=True, kw_only=True)
class PublishedRow:
    """A row of the paper's Table 1.

    Attributes:
        method: Name of the method in the table.
        trunk: Name of the trunk in the table.
        colour: Whether it was trained with colour.
        new_loss: Whether it was trained with the new loss ("NL").
        mean: Mean AP50 [%].
        ap50: (12,) AP50 of each category in the order of ``SCORED`` [%].
    """

    method: str
    trunk: str
    colour: bool
    new_loss: bool
    mean: float
    ap50: tuple[float, ...]

    def name(self) -> str:
        """Return the label of the row."""
        extras = [word for word, used in (("colour", self.colour), ("new loss", self.new_loss)) if used]
        return f"{self.method} ({', '.join([self.trunk, *extras])})"


TABLE_1 = (
    PublishedRow(
        method="SGPN",
        trunk="PointNet",
        colour=True,
        new_loss=False,
        mean=26.4,
        ap50=(43.6, 89.4, 47.4, 0.0, 1.0, 55.3, 8.7, 17.2, 18.6, 0.0, 20.5, 15.4),
    ),
    PublishedRow(
        method="paper",
        trunk="DGCNN",
        colour=True,
        new_loss=False,
        mean=27.7,
        ap50=(44.0, 90.5, 55.2, 0.0, 1.3, 46.7, 2.2, 16.0, 41.5, 0.0, 17.5, 17.3),
    ),
    PublishedRow(
        method="paper",
        trunk="DGCNN",
        colour=False,
        new_loss=True,
        mean=27.6,
        ap50=(48.5, 89.8, 50.8, 0.0, 0.4, 32.4, 41.2, 18.3, 39.1, 0.0, 9.2, 1.1),
    ),
    PublishedRow(
        method="paper",
        trunk="DGCNN",
        colour=True,
        new_loss=True,
        mean=31.2,
        ap50=(48.2, 91.7, 62.6, 0.0, 4.0, 42.6, 7.7, 22.1, 53.1, 0.0, 13.9, 28.7),
    ),
)


def table_rows(ours: Sequence[tuple[str, S3disScores]]) -> list[list[str]]:
    """Return the cells of Table 1 [%]: a heading, the published rows, and a row for each (name, scores) of ours."""
    rows = [["AP50 [%]", "mean", *SCORED]]
    rows += [[row.name(), *(f"{value:.1f}" for value in (row.mean, *row.ap50))] for row in TABLE_1]
    rows += [[name, *(_percent(value) for value in (s.mean_ap50, *s.ap50.values()))] for name, s in ours]
    return rows


def _percent(value: float) -> str:
    return "–" if np.isnan(value) else f"{100 * value:.1f}"
