"""Generated parts: clean solids of the promised size, the same bits each time, with convex pieces that cover them."""

import numpy as np
import pytest
import trimesh

from binpick_env.parts import Part, load_part
from binpick_env.parts.families import FAMILIES, parse_name
from binpick_env.parts.families.generator import LEAST_SHARE, LEAST_WALL, drawing_of
from binpick_env.parts.families.solid import as_trimesh

EVERY = [f"generated:{family}:{index}" for family in FAMILIES for index in (0, 1)]


@pytest.fixture(params=EVERY)
def part(request: pytest.FixtureRequest) -> Part:
    return load_part(request.param)


def test_generated_part_is_one_clean_solid_of_a_parts_size(part: Part) -> None:
    mesh = part.model.mesh
    assert mesh.is_volume
    assert mesh.body_count == 1
    assert len(mesh.faces) <= 8000
    assert 0.02 <= part.model.d_max <= 0.2
    np.testing.assert_allclose(part.model.centre, 0.0, atol=1e-9)
    assert part.mass == pytest.approx(mesh.volume * part.density)
    assert part.source == part.model.name


def test_walls_are_thick_enough(part: Part) -> None:
    drawing = drawing_of(parse_name(part.source))
    scale = (part.model.mesh.volume / drawing.solid.mesh.volume()) ** (1 / 3)
    assert drawing.wall * scale >= max(LEAST_WALL, LEAST_SHARE * part.model.d_max) * (1 - 1e-9)


def test_pieces_are_convex_and_cover_the_part_without_its_bores(part: Part) -> None:
    filled = as_trimesh(drawing_of(parse_name(part.source)).solid.filled)
    scale = (part.model.mesh.volume / abs(drawing_of(parse_name(part.source)).solid.mesh.volume())) ** (1 / 3)
    for piece in part.pieces:
        assert piece.is_watertight
        assert piece.volume == pytest.approx(piece.convex_hull.volume, rel=1e-6)
        assert len(piece.vertices) <= 128
    assert len(part.pieces) <= 16
    # Circles of 32 facets lose 0.5 % of those of 60. The chords of eight sectors close at most a third of a thin ring.
    covered = trimesh.boolean.union(list(part.pieces), engine="manifold").volume
    assert 0.95 < covered / (filled.volume * scale**3) < 1.35
    bounds = np.array([piece.bounds for piece in part.pieces])
    over = np.maximum(part.model.mesh.bounds[0] - bounds[:, 0].min(0), bounds[:, 1].max(0) - part.model.mesh.bounds[1])
    assert np.abs(over).max() < 0.005 * part.model.d_max
