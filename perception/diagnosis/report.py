"""What a diagnosis says: facts of a frame, and likely causes in words that a user can act on."""

from dataclasses import dataclass, fields
from typing import Literal, get_args

from perception.boundary import BoundarySource
from perception.diagnosis.bin_facts import BinFacts

CauseName = Literal[
    "depth_unit",
    "depth_range",
    "missing_depth",
    "no_depth",
    "sparse_depth",
    "inner_size_unit",
    "camera_matrix",
    "camera_axes",
    "camera_inverted",
    "bin_pose",
    "bin_size",
    "underexposed",
    "overexposed",
    "thin_part",
    "depth_noise",
    "few_pixels",
    "floor_height",
    "partly_outside",
]

_SOURCES: dict[BoundarySource, str] = {
    "grey": "",
    "depth": "; edges of the depth alone",
    "both": "; edges of the grey image and of the depth",
}


@dataclass(frozen=True, kw_only=True)
class Cause:
    """A likely cause of lost parts.

    Attributes:
        name: Short name, to count and to compare by.
        text: What was measured, what it suggests, and what to do.
    """

    name: CauseName
    text: str

    def __post_init__(self) -> None:
        if self.name not in get_args(CauseName):
            raise ValueError(f"name must be one of {', '.join(get_args(CauseName))}, got {self.name!r}")


@dataclass(frozen=True, kw_only=True)
class PoseCounts:
    """What became of the groups of boundary points in the pose estimation; each counts once.

    Attributes:
        groups: Number of groups that were searched for a pose.
        found: Groups with a verified pose.
        by_floor: Groups without one whose best hypothesis reached through the floor of the bin.
        by_walls: Groups without one whose best hypothesis reached through a wall of the bin.
        by_neighbours: Groups whose pose has a high enough score, but collides with a better one, or is the same.
        by_score: Groups whose pose has too low a score.
        without_pose: Groups about which there is no hypothesis, or none that better poses of others leave possible.
    """

    groups: int
    found: int = 0
    by_floor: int = 0
    by_walls: int = 0
    by_neighbours: int = 0
    by_score: int = 0
    without_pose: int = 0

    def __post_init__(self) -> None:
        counts = [getattr(self, each.name) for each in fields(self)]
        if min(counts) < 0 or sum(counts[1:]) != self.groups:
            raise ValueError(f"each of the groups must count once, got {self}")


@dataclass(frozen=True, kw_only=True)
class FrameReport:
    """Facts of a frame and likely causes of lost parts.

    Attributes:
        pixels: Number of pixels in the rectangle of the image that shows the bin.
        depth_share: Share of these pixels that have a depth, in [0, 1].
        median_depth: Median of these depths [m]; None without any.
        boundary_points: Number of boundary points in the bin.
        outside: Number of edge points in the image of the bin that lie outside its box.
        part_pixels: Expected length of a part in the image, along its largest extent [px]; None without depth.
        poses: What became of the groups; None if no poses were estimated.
        causes: Likely causes, those to settle first first; empty for a good frame.
        bin: What was measured of the bin; None if it was taken as given.
        in_view: Share of the bin's image that lies within the frame, in [0, 1]; 1 where the bin's pose is in doubt.
        region: Whether all that the frame measures was searched, in place of a bin.
        boundary_source: Images that the boundary points were found in: the depth where there is no grey image.
    """

    pixels: int
    depth_share: float
    median_depth: float | None
    boundary_points: int
    outside: int
    part_pixels: float | None
    poses: PoseCounts | None
    causes: tuple[Cause, ...]
    bin: BinFacts | None = None
    in_view: float = 1.0
    boundary_source: BoundarySource = "grey"
    region: bool = False

    def __str__(self) -> str:
        depth = "no depth" if self.median_depth is None else f"median depth {self.median_depth:.4g} m"
        where, points = (
            "bin in the image",
            f"{self.boundary_points} in the bin, {self.outside} edge points outside its box",
        )
        if self.region:
            where, points = "region searched", f"{self.boundary_points}"
        lines = [
            f"{where}: {self.pixels} pixels, {100 * self.depth_share:.1f} % with depth, {depth}",
            f"boundary points: {points}{_SOURCES[self.boundary_source]}",
        ]
        if self.bin is not None:
            lines.insert(0 if self.region else len(lines), str(self.bin))
        if self.part_pixels is not None:
            lines.append(f"a part is about {self.part_pixels:.0f} pixels long")
        if self.poses is not None:
            n = self.poses
            lines.append(
                f"poses: {n.found} of {n.groups} groups; rejected: {n.by_floor} by the floor, {n.by_walls} by the "
                f"walls, {n.by_neighbours} by neighbours, {n.by_score} by score; {n.without_pose} without a pose"
            )
        lines += [f"likely cause: {cause.text}" for cause in self.causes] or ["no likely cause of lost parts"]
        return "\n".join(lines)
