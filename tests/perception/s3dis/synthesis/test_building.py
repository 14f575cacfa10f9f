"""Synthetic rooms: determinism, the on-disk format, and that things are where they ought to be."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from binpick_env.jobs import node
from binpick_env.jobs.workers import Cluster
from perception.runtime import file_work
from perception.runtime.file_work import Run
from perception.s3dis.data.categories import CATEGORIES, SCORED
from perception.s3dis.data.raw_tree import find_raw_rooms
from perception.s3dis.data.room import Room
from perception.s3dis.evaluation.identities import predict_merged_ground_truth_blocks
from perception.s3dis.scoring import S3disScores, match_room
from perception.s3dis.synthesis import building as synthesis
from perception.s3dis.synthesis.building import SynthesisConfig, make_room, room_name, synthesize_rooms
from perception.s3dis.synthesis.furnishing import KINDS, make_interior
from perception.s3dis.synthesis.solids import Brush, joined, moved
from tests.binpick_env.jobs.node_map import node_map

SPARSE = SynthesisConfig(seed=31, density=60)


def brush(density: float = 400.0) -> Brush:
    return Brush(density, np.random.default_rng(31))


def test_a_rectangle_holds_its_points_its_density_and_its_normal() -> None:
    cloud = brush().rectangle([1, 2, 3], [2, 0, 0], [0, 0, 1], (10, 20, 30))
    assert len(cloud.points) == pytest.approx(800, abs=1)
    assert (cloud.points.min(axis=0) >= [1, 2, 3]).all()
    assert (cloud.points.max(axis=0) <= [3, 2, 4]).all()
    np.testing.assert_allclose(np.abs(cloud.normals), np.tile([0.0, 1.0, 0.0], (len(cloud.points), 1)))
    assert (cloud.colours == [10, 20, 30]).all()


def test_a_hole_has_no_points_in_metres_along_the_edges() -> None:
    cloud = brush().pierced([0, 0, 0], [4, 0, 0], [0, 0, 2], (0, 0, 0), [(1, 2, 0.5, 1.5)])
    x, z = cloud.points[:, 0], cloud.points[:, 2]
    assert not ((x > 1) & (x < 2) & (z > 0.5) & (z < 1.5)).any()
    assert len(cloud.points) == pytest.approx(400 * 7, rel=0.05)


def test_a_box_has_no_underside_and_a_cylinder_its_radius() -> None:
    box = brush().box([0, 0, 0], [1, 2, 3], (0, 0, 0))
    assert len(box.points) == pytest.approx(400 * (2 + 2 * 3 + 2 * 6), abs=5)
    assert (box.points[:, 2] > 0).all()
    side = brush().cylinder([1, 1, 0], 0.5, 2, (0, 0, 0), cap=False)
    np.testing.assert_allclose(np.linalg.norm(side.points[:, :2] - 1, axis=1), 0.5)
    assert len(side.points) == pytest.approx(400 * 2 * np.pi, abs=1)
    assert len(joined([]).points) == 0


def test_to_move_is_to_turn_about_z_and_then_to_shift() -> None:
    cloud = brush(1.0).rectangle([1, 0, 0], [1e-9, 0, 0], [0, 1e9, 0], (0, 0, 0))
    turned = moved(cloud, np.pi / 2, (0, 0, 5))
    np.testing.assert_allclose(turned.points[:, 1], cloud.points[:, 0], atol=1e-3)
    np.testing.assert_allclose(turned.points[:, 0], -cloud.points[:, 1], atol=1e-3)
    assert (turned.points[:, 2] == 5).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_room_is_closed_furnished_and_its_furniture_inside(kind: str) -> None:
    items = make_interior(KINDS[kind], Brush(80.0, np.random.default_rng(31)))
    by_name: dict[str, list[np.ndarray]] = {}
    for category, cloud in items:
        by_name.setdefault(category, []).append(cloud.points)
    assert (len(by_name["floor"]), len(by_name["ceiling"]), len(by_name["wall"])) == (1, 1, 4)
    assert len(by_name["door"]) >= 1
    low, high = by_name["floor"][0].min(axis=0), by_name["ceiling"][0].max(axis=0)
    assert 2.5 <= high[2] <= 3.2
    for name in set(by_name) - {"door", "window", "floor", "ceiling"}:
        for points in by_name[name]:
            assert (points[:, :2] >= low[:2] - 0.15).all(), name
            assert (points[:, :2] <= high[:2] + 0.15).all(), name
            assert points[:, 2].min() >= -1e-9, name
            assert points[:, 2].max() <= high[2] + 1e-9, name


@pytest.mark.slow
def test_all_categories_occur_and_all_kinds() -> None:
    rooms = [make_room(SPARSE, k) for k in range(40)]
    assert {item.name.rsplit("_", 1)[0] for room in rooms for item in room} == set(CATEGORIES)
    assert {room_name(SPARSE, k).split("/")[1].split("_")[0] for k in range(40)} == set(KINDS)


def test_a_room_is_the_same_bits_whatever_was_made_before() -> None:
    first = make_room(SPARSE, 3)
    make_room(SPARSE, 2)
    again, other = make_room(SPARSE, 3), make_room(SynthesisConfig(seed=32, density=60), 3)
    assert [item.name for item in first] == [item.name for item in again]
    assert all(a.xyz.tobytes() == b.xyz.tobytes() for a, b in zip(first, again, strict=True))
    assert all(a.rgb.tobytes() == b.rgb.tobytes() for a, b in zip(first, again, strict=True))
    assert first[0].xyz.tobytes() != other[0].xyz.tobytes()


def test_density_and_noise_arrive() -> None:
    thin, thick = (sum(len(i.xyz) for i in make_room(SynthesisConfig(seed=31, density=d), 0)) for d in (50, 200))
    assert thick == pytest.approx(4 * thin, rel=0.3)  # the same seed furnishes another room: more points, more draws
    for noise in (0.0, 0.02):
        floor = next(i for i in make_room(SynthesisConfig(seed=31, density=60, noise=noise), 0) if i.name == "floor_1")
        assert np.std(floor.xyz[:, 2]) == pytest.approx(noise, rel=0.15, abs=1e-12)


def test_areas_take_turns_and_the_tree_can_be_read(tmp_path: Path) -> None:
    names = list(synthesize_rooms(SPARSE, 8, tmp_path))
    assert [name.split("/")[0] for name in names] == [f"Area_{k}" for k in (1, 2, 3, 4, 5, 6, 1, 2)]
    assert len(set(names)) == 8
    rooms = {room.name: room.read() for room in find_raw_rooms(tmp_path)}
    assert set(rooms) == set(names)
    objects = {item.name: item for item in make_room(SPARSE, 4)}
    read = rooms[names[4]]
    k = sorted(f"{name}.txt" for name in objects).index("floor_1.txt")
    floor = read.instance == k
    np.testing.assert_allclose(read.xyz[floor], objects["floor_1"].xyz, atol=6e-4)  # three decimals
    np.testing.assert_array_equal(read.rgb[floor], objects["floor_1"].rgb)
    assert (read.semantic[floor] == CATEGORIES.index("floor")).all()


def test_rooms_that_are_there_are_kept_and_no_half_one_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    list(synthesize_rooms(SPARSE, 1, tmp_path))
    (kept,) = (path for path in tmp_path.glob("Area_*/*/Annotations/floor_1.txt"))
    before = kept.stat().st_mtime_ns
    written = []

    def fail(item: object) -> str:
        if written:
            raise OSError("disk full")
        written.append(item)
        return "1 2 3 4 5 6\n"

    with monkeypatch.context() as patch:
        patch.setattr(synthesis, "_text", fail)
        with pytest.raises(OSError, match="disk full"):
            list(synthesize_rooms(SPARSE, 2, tmp_path))
    assert kept.stat().st_mtime_ns == before
    assert list((tmp_path / "Area_2").iterdir()) == []
    assert len(list(synthesize_rooms(SPARSE, 2, tmp_path))) == 2


def test_half_a_room_that_a_node_has_sent_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node.tempfile, "tempdir", str(tmp_path))
    on_node: Run[str] = partial(node_map, cluster=Cluster())
    write, written = file_work.write_bytes_atomically, []

    def stopped(path: Path, content: bytes) -> None:
        written.append(path.name)
        if len(written) == 3:
            raise KeyboardInterrupt
        write(path, content)

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(file_work, "write_bytes_atomically", stopped)
        with pytest.raises(KeyboardInterrupt):
            list(synthesize_rooms(SPARSE, 1, out, on_node))
    assert list(out.rglob("*.txt")) == []
    assert list(synthesize_rooms(SPARSE, 1, out, on_node)) == list(synthesize_rooms(SPARSE, 1, tmp_path / "here"))
    texts = {path.relative_to(out): path.read_bytes() for path in out.rglob("*.txt")}
    assert set(written[:2]) < {path.name for path in texts}
    assert texts == {path: (tmp_path / "here" / path).read_bytes() for path in texts}


def test_rooms_that_are_there_are_not_sent_to_a_cluster(tmp_path: Path) -> None:
    (first,) = synthesize_rooms(SPARSE, 1, tmp_path)
    sent: list[int] = []

    def run(work: Callable[[int], str], indices: Sequence[int]) -> Iterator[str]:
        sent.extend(indices)
        return map(work, indices)

    assert list(synthesize_rooms(SPARSE, 2, tmp_path, run)) == [first, room_name(SPARSE, 1)]
    assert sent == [1]


def test_true_blocks_of_furnished_rooms_merge_back() -> None:
    matches = []
    for k in range(6):
        objects = make_room(SynthesisConfig(seed=31, density=300), k)
        counts = [len(item.xyz) for item in objects]
        categories = [CATEGORIES.index(item.name.rsplit("_", 1)[0]) for item in objects]
        room = Room(
            name=f"Area_1/office_{k}",
            xyz=np.concatenate([item.xyz for item in objects]).astype(np.float32),
            rgb=np.concatenate([item.rgb for item in objects]),
            semantic=np.repeat(np.array(categories, np.uint8), counts),
            instance=np.repeat(np.arange(len(counts), dtype=np.int32), counts),
        )
        matches.append(match_room(predict_merged_ground_truth_blocks, room))
    found = S3disScores.of(matches)
    assert found.mean_ap50 >= 0.99
    assert found.ap >= 0.98
    assert sum(not np.isnan(found.ap50[name]) for name in SCORED) >= 9


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"density": 0.0}, "density must be positive and noise not negative, got 0.0 and 0.003"),
        ({"noise": -0.1}, "density must be positive and noise not negative, got 1000.0 and -0.1"),
    ],
)
def test_nonsense_is_rejected(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SynthesisConfig(**changes)  # type: ignore[arg-type]


def test_at_least_one_room() -> None:
    with pytest.raises(ValueError, match="rooms must be at least 1, got 0"):
        synthesize_rooms(SPARSE, 0, Path("nowhere"))
