"""Small trees and rooms for the tests of S3DIS."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from perception.s3dis.data.categories import CATEGORIES
from perception.s3dis.data.room import Room

LINES = "1.500 -2.250 0.125 10 20 30\n1.000 2.000 3.000 255 0 128\n"


def write_tree(root: Path, members: Mapping[str, str]) -> Path:
    """Write texts to ``root/Area_1/office_1/Annotations/...``; keys are ``Area_1/office_1/chair_1``."""
    for name, text in members.items():
        room, member = name.rsplit("/", 1)
        path = root / room / "Annotations" / f"{member}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.encode("latin-1"))
    return root


def boxes_room(
    objects: list[tuple[str, tuple[float, float, float]]],
    points: int = 150,
    seed: int = 31,
    name: str = "Area_5/office_1",
) -> Room:
    """Return a room of 0.4 m cubes full of points; each object is its category and its least corner [m]."""
    rng = np.random.default_rng(seed)
    xyz = np.concatenate([np.array(low) + rng.uniform(0, 0.4, (points, 3)) for _, low in objects])
    categories = np.array([CATEGORIES.index(category) for category, _ in objects], np.uint8)
    return Room(
        name=name,
        xyz=xyz.astype(np.float32),
        rgb=rng.integers(0, 256, (len(xyz), 3)).astype(np.uint8),
        semantic=np.repeat(categories, points),
        instance=np.repeat(np.arange(len(objects), dtype=np.int32), points),
    )


def told_by_colour_room(seed: int = 31, name: str = "Area_5/office_1", points: int = 400) -> Room:
    """Return a room of cubes whose red is the object and whose green is the category: what a network should say."""
    rng = np.random.default_rng(seed)
    kinds = ("chair", "chair", "table", "board", "sofa", "clutter", "door", "column", "chair")[: 6 + seed % 3]
    places = rng.permutation(12)[: len(kinds)]
    objects = [(kind, (0.6 * (at % 4), 0.6 * (at // 4), 0.0)) for kind, at in zip(kinds, places.tolist(), strict=True)]
    room = boxes_room(objects, points, seed, name)
    rgb = np.column_stack([room.instance, room.semantic, np.full(len(room), 7)]).astype(np.uint8)
    return replace(room, rgb=rgb)
