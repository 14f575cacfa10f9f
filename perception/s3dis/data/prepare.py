"""Conversion of the raw tree to compact files, one for each room."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from perception.runtime.file_work import FolderWork, InputWork, Run
from perception.runtime.files import write_atomically
from perception.s3dis.data.categories import CATEGORIES
from perception.s3dis.data.raw_tree import RawRoom
from perception.s3dis.data.record import recorded
from perception.s3dis.data.room import FORMAT, ROOMS_NOTE, Room, RoomError, room_path

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PreparedRoom:
    """Result of the preparation of a room.

    Attributes:
        name: Name of the room, such as "Area_5/office_1".
        points: Number of points.
        objects: Number of objects by category.
        remarks: Irregularities of its raw files.
        new: Whether the room was read now; otherwise a complete file was there.
    """

    name: str
    points: int
    objects: dict[str, int]
    remarks: tuple[str, ...]
    new: bool


def prepare_rooms(rooms: Sequence[RawRoom], out: Path, run: Run[PreparedRoom] = map) -> Iterator[PreparedRoom]:
    """Write a file for each room and yield each result; at the end, write a description of the folder.

    A complete file that was made from the same raw files is kept. Any other file is made again.

    Args:
        rooms: Rooms of the raw tree.
        out: Folder of the files.
        run: Maps work over the indices of the rooms to make, each of which reads its raw files. The largest room comes
            first, which balances processes.

    Raises:
        RawDataError: A raw file is malformed; finished rooms remain.
    """
    order = sorted(range(len(rooms)), key=lambda k: -sum(rooms[k].sizes))
    done, missing = [], []
    for k in order:
        room = _finished(room_path(out, rooms[k].name), rooms[k].digest())
        if room is None:
            missing.append(k)
        else:
            done.append(_prepared(room, new=False))
            yield done[-1]
    work = InputWork(FolderWork(partial(_prepare, tuple(rooms)), out), {k: rooms[k].files() for k in missing})
    for prepared in run(work, missing):
        done.append(prepared)
        yield prepared
    done.sort(key=lambda prepared: prepared.name)
    write_atomically(out / ROOMS_NOTE, recorded(_note(rooms, done)))


def summary(done: Sequence[PreparedRoom]) -> dict[str, Any]:
    """Return the number of rooms, of new rooms and of points, and all remarks."""
    return {
        "rooms": len(done),
        "new": sum(room.new for room in done),
        "points": sum(room.points for room in done),
        "remarks": [remark for room in done for remark in room.remarks],
    }


def _prepare(rooms: Sequence[RawRoom], out: Path, index: int) -> PreparedRoom:
    room = rooms[index].read()
    room.save(room_path(out, room.name))
    return _prepared(room, new=True)


def _prepared(room: Room, new: bool) -> PreparedRoom:
    categories = room.category_of_instance()[np.unique(room.instance)]
    numbers = np.bincount(categories, minlength=len(CATEGORIES)).tolist()
    return PreparedRoom(
        name=room.name,
        points=len(room),
        objects={name: number for name, number in zip(CATEGORIES, numbers, strict=True) if number},
        remarks=room.remarks,
        new=new,
    )


def _finished(path: Path, source: str) -> Room | None:
    if not path.exists():
        return None
    try:
        room = Room.load(path)
    except RoomError as error:
        _log.warning("made again: %s", error)
        return None
    return room if room.source == source else None


def _note(rooms: Sequence[RawRoom], done: Sequence[PreparedRoom]) -> dict[str, Any]:
    return {
        "version": FORMAT.version,
        "raw": str(rooms[0].root.resolve()) if rooms else "",
        "categories": CATEGORIES,
        "rooms": {p.name: {"points": p.points, "objects": p.objects} for p in done},
        "remarks": [remark for p in done for remark in p.remarks],
    }
