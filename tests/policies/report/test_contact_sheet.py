"""Pictures of generated parts: shape, shading and layout of the sheet."""

import numpy as np
import pytest
import trimesh

from binpick_env.parts.families import FAMILIES
from policies.report.contact_sheet import family_sheet, portrait


def test_portrait_shows_the_outline_and_the_light_from_the_upper_left() -> None:
    picture = portrait(trimesh.creation.icosphere(subdivisions=3, radius=0.01), np.eye(3), 100)
    part = picture < 250
    assert abs(part.mean() - np.pi / 4 * 0.9**2) < 0.01
    assert part.any(axis=0).sum() == part.any(axis=1).sum()
    assert picture[30, 35] > picture[70, 65] + 50


def test_portrait_keeps_right_and_up() -> None:
    ell = trimesh.util.concatenate(
        [trimesh.creation.box(bounds=[(0, 0, 0), (3, 1, 1)]), trimesh.creation.box(bounds=[(0, 1, 0), (1, 3, 1)])]
    )
    picture = portrait(ell, np.eye(3), 60)
    assert picture[20, 45] == 255  # nothing at the upper right
    assert (picture[[20, 40, 40], [15, 15, 45]] < 255).all()


@pytest.mark.slow
def test_sheet_has_a_tile_for_every_family() -> None:
    sheet = family_sheet(0)
    rows = -(-len(FAMILIES) // 9)
    assert sheet.shape == (rows * 170, 9 * 150, 3)
    for k in range(len(FAMILIES)):
        row, column = divmod(k, 9)
        tile = sheet[row * 170 : row * 170 + 150, column * 150 : (column + 1) * 150]
        assert (tile < 250).mean() > 0.02
    assert (sheet[:, :, 0] > sheet[:, :, 1].astype(int) + 50).any()  # red names of held-out families
