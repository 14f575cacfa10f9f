"""How large a part is in the camera's image, and from how near the camera still sees the whole bin."""

from dataclasses import dataclass

from binpick_env.config import CellConfig
from binpick_env.options import CellOptions
from binpick_env.part_limits import bin_capacity, largest_d_max
from binpick_env.parts.part import Part
from binpick_env.scenes.whole_part import whole_part_points

JITTER = 0.05  # change of the camera's distance from scene to scene [m]
_PILE = 0.25  # height of the pile's parts over the floor, as a share of the bin's height


@dataclass(frozen=True, kw_only=True)
class SightFacts:
    """How the camera sees a part and the bin.

    Attributes:
        distance: Distance of the camera from the bin's floor [m].
        image: Width and height of the image [px].
        depth: Depth of the parts on the pile in the camera's image [m]: a quarter of the bin's height over the floor.
        d_max_px: Largest extent of a part on the pile [px].
        points: Number of boundary points of an unoccluded part on the pile, in its largest view.
        nearest: Distance of the camera at which the bin's rim just fills the image [m].
        whole_bin: Whether the whole bin is in the image.
    """

    distance: float
    image: tuple[int, int]
    depth: float
    d_max_px: float
    points: float
    nearest: float
    whole_bin: bool


@dataclass(frozen=True, kw_only=True)
class BinFacts:
    """How many parts the bin holds.

    Attributes:
        inner_size: Length, width and height inside the bin [m].
        capacity: Number of parts whose hulls take 40 % of the bin's volume, at least 1.
        wanted: Smallest number of parts that a bin was to hold.
        dropped: Smallest and largest number of parts that are dropped into a bin.
        largest_d_max: Largest ``d_max`` of parts of which the bin holds a pile [m].
    """

    inner_size: tuple[float, float, float]
    capacity: int
    wanted: int
    dropped: tuple[int, int]
    largest_d_max: float


def sight_facts(options: CellOptions, part: Part) -> SightFacts:
    """Return how the camera sees a part and the bin.

    Args:
        options: Part and cell.
        part: The same part, loaded.

    Note:
        The number of points is rendered, in some seconds, and cached on disk.
    """
    cell = options.cell()
    camera = cell.camera
    depth = camera.distance - _PILE * cell.bin.inner_size[2]
    nearest = nearest_distance(cell)
    return SightFacts(
        distance=camera.distance,
        image=(camera.width, camera.height),
        depth=depth,
        d_max_px=camera.focal_px * part.model.d_max / depth,
        points=whole_part_points(options.part, options.unit, camera) / depth,
        nearest=nearest,
        whole_bin=camera.distance >= nearest,
    )


def bin_facts(options: CellOptions, part: Part, wanted: int, dropped: tuple[int, int]) -> BinFacts:
    """Return how many parts the bin holds.

    Args:
        options: Part and cell.
        part: The same part, loaded.
        wanted: Smallest number of parts that a bin is to hold.
        dropped: Smallest and largest number of parts that are dropped into a bin.
    """
    config = options.cell().bin
    return BinFacts(
        inner_size=config.inner_size,
        capacity=bin_capacity(part, config.inner_size),
        wanted=wanted,
        dropped=dropped,
        largest_d_max=largest_d_max(config),
    )


def nearest_distance(cell: CellConfig) -> float:
    """Return the distance of the camera at which the bin's rim just fills the image [m]."""
    camera, (length, width, height) = cell.camera, cell.bin.inner_size
    return height + camera.focal_px * max(length / camera.width, width / camera.height)
