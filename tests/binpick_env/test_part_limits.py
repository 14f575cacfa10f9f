"""What the cell says of a part from a file that its bin or its jaw cannot take."""

import logging
from pathlib import Path

import pytest
import trimesh

from binpick_env.config import BinConfig
from binpick_env.env import BinPickEnv
from binpick_env.options import CellOptions
from binpick_env.part_limits import bin_capacity, largest_d_max, require_room
from binpick_env.parts import load_part


def block(folder: Path, *sides: float) -> str:
    path = folder / "block.ply"
    trimesh.creation.box(sides).export(path)
    return str(path)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        (
            0.010,
            r"must be 0.02 to 0.2 m in this cell \(the camera sees too few points .*\), got 0.0173",
        ),
        (
            0.130,
            r"\(no pile of larger ones lies in a bin of 360 x 260 x 120 mm\), got 0.2252 m, read as m; --unit",
        ),
    ],
)
def test_a_part_too_small_or_too_large_is_refused(tmp_path: Path, cache: Path, size: float, message: str) -> None:
    path = block(tmp_path, size, size, size)
    with pytest.raises(ValueError, match=message):
        CellOptions(part=path, unit="m", symmetry="none").load_part()
    with pytest.raises(ValueError, match=message):
        BinPickEnv(load_part(path, unit="m", symmetry="none"), perception="oracle")


def test_the_largest_part_follows_the_bin(tmp_path: Path, cache: Path) -> None:
    options = {"part": block(tmp_path, 0.13, 0.13, 0.13), "unit": "m", "symmetry": "none"}
    assert CellOptions(**options, bin=(0.4, 0.32, 0.2)).load_part().model.d_max == pytest.approx(0.2252, rel=1e-3)
    with pytest.raises(ValueError, match=r"must be 0.02 to 0.154 m in this cell .* in a bin of 300 x 200 x 100 mm"):
        CellOptions(**options, bin=(0.3, 0.2, 0.1)).load_part()
    assert largest_d_max(BinConfig()) == 0.2


@pytest.mark.parametrize(
    ("side", "jaw", "widest"), [(0.080, None, 75), (0.070, None, None), (0.070, 0.06, 50), (0.049, 0.06, None)]
)
def test_a_part_too_wide_for_the_jaw_is_said_once(
    tmp_path: Path, cache: Path, caplog: pytest.LogCaptureFixture, side: float, jaw: float | None, widest: int | None
) -> None:
    options = CellOptions(part=block(tmp_path, side, side + 0.001, side + 0.002), symmetry="none", jaw=jaw)
    with caplog.at_level(logging.WARNING):
        options.load_part()
        options.load_part()
    text = f"is under {widest} mm (the smallest: {1000 * side:g} mm): the jaw has little or no room for it"
    assert caplog.text.count(text) == (widest is not None)
    assert caplog.text.count("the jaw") == (widest is not None)


def test_a_bin_holds_parts_whose_hulls_take_two_fifths_of_it() -> None:
    tee = load_part("tee")
    hull = tee.model.mesh.convex_hull.volume
    assert bin_capacity(tee, (1.0, 1.0, 10.4 * hull / 0.4)) == 10
    assert bin_capacity(tee, (0.01, 0.01, 0.01)) == 1


@pytest.mark.parametrize(("name", "most"), [("generated:hex_bolt:0", 10), ("tee", 16)])
def test_hulls_or_the_parts_own_volume_limit_what_can_be_heaped_on_a_bin(name: str, most: int) -> None:
    part = load_part(name)
    solid, hull = (mesh.volume for mesh in (part.model.mesh, part.model.mesh.convex_hull))
    bin_of_ten = BinConfig(inner_size=(1.0, 1.0, 10.4 * hull))
    assert most == max(10, int(0.6 * 10.4 * hull / solid))
    require_room(part, bin_of_ten, most)
    with pytest.raises(ValueError, match=rf"{most + 1} parts .* full with 4, and no more than {most} can be heaped"):
        require_room(part, bin_of_ten, most + 1)
