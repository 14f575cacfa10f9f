"""The folder tree of S3DIS as it is published: ``Area_*/ROOM/Annotations/CATEGORY_NUMBER.txt``."""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perception.s3dis.data.annotation import RawDataError, read_annotation
from perception.s3dis.data.categories import CATEGORIES, READ_AS
from perception.s3dis.data.room import Room

MEMBERS = "Annotations"
REPEATED = ("Area_5/office_36/Annotations/wall_3 (1).txt",)  # a second copy of wall_3.txt in some archives
_MEMBER = re.compile(r"([A-Za-z]+)_(\d+)\.txt")


@dataclass(frozen=True, kw_only=True)
class RawRoom:
    """The raw files of a room, not read yet.

    Attributes:
        root: Root of the tree.
        name: Name of the room, such as "Area_5/office_1".
        members: Names of the annotation files; file i holds the object of id i.
        categories: Index into ``CATEGORIES`` of each file.
        sizes: Size of each file [bytes].
        remarks: Irregularities of the names.
    """

    root: Path
    name: str
    members: tuple[str, ...]
    categories: tuple[int, ...]
    sizes: tuple[int, ...]
    remarks: tuple[str, ...] = ()

    def digest(self) -> str:
        """Return a sha256 over names, categories and sizes of the files."""
        return hashlib.sha256(repr((self.members, self.categories, self.sizes)).encode()).hexdigest()

    def files(self) -> list[Path]:
        """Return the paths of the annotation files."""
        return [self.root / self.name / MEMBERS / member for member in self.members]

    def read(self) -> Room:
        """Read all annotation files of the room.

        Raises:
            RawDataError: A file is malformed.
        """
        read = [read_annotation(path, f"{self.name}/{MEMBERS}/{path.name}") for path in self.files()]
        counts = [len(annotation.xyz) for annotation in read]
        return Room(
            name=self.name,
            xyz=np.concatenate([annotation.xyz for annotation in read]),
            rgb=np.concatenate([annotation.rgb for annotation in read]),
            semantic=np.repeat(np.array(self.categories, np.uint8), counts),
            instance=np.repeat(np.arange(len(counts), dtype=np.int32), counts),
            source=self.digest(),
            remarks=(*self.remarks, *(annotation.remark for annotation in read if annotation.remark)),
        )


def find_raw_rooms(root: Path) -> list[RawRoom]:
    """Return the rooms of a tree in the order of their names; the names of all annotation files are checked.

    Raises:
        RawDataError: There are no rooms, a room has no annotations, or the name of a file is malformed.
    """
    folders = [
        room
        for area in sorted(root.glob("Area_*"))
        if re.fullmatch(r"Area_\d+", area.name) and area.is_dir()
        for room in sorted(area.iterdir())
        if room.is_dir() and not room.name.startswith(".")
    ]
    if not folders:
        found = "holds no Area_*/ROOM folders" if root.is_dir() else "is no folder"
        raise RawDataError(f"{root} {found}; it must be the folder that Area_1 is in")
    return [_raw_room(root, folder) for folder in folders]


def _raw_room(root: Path, folder: Path) -> RawRoom:
    name = folder.relative_to(root).as_posix()
    members, categories, sizes, remarks = [], [], [], []
    for path in sorted((folder / MEMBERS).glob("*.txt")):
        inside = f"{name}/{MEMBERS}/{path.name}"
        if path.name.startswith("."):
            continue
        if inside in REPEATED:
            remarks.append(f"{inside}: left out, a second copy")
            continue
        category, remark = _category(path, inside)
        members.append(path.name)
        categories.append(category)
        sizes.append(path.stat().st_size)
        remarks += [remark] if remark else []
    if not members:
        raise RawDataError(f"{folder} holds no {MEMBERS}/*.txt")
    return RawRoom(
        root=root,
        name=name,
        members=tuple(members),
        categories=tuple(categories),
        sizes=tuple(sizes),
        remarks=tuple(remarks),
    )


def _category(path: Path, inside: str) -> tuple[int, str]:
    """Return the category in the name of a file, and a remark if the name is not one of the thirteen."""
    found = _MEMBER.fullmatch(path.name)
    if found is None:
        raise RawDataError(f"{path}: a member must be called CATEGORY_NUMBER.txt")
    word = found[1]
    if word not in CATEGORIES and word not in READ_AS:
        raise RawDataError(f"{path}: {word!r} is none of {', '.join(CATEGORIES)}, {', '.join(READ_AS)}")
    category = READ_AS.get(word, word)
    return CATEGORIES.index(category), "" if category == word else f"{inside}: {word} read as {category}"
