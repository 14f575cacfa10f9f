"""How a frame is read, and what the reading found."""

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Literal

from perception.capture.calibration import require_length

Axes = Literal["opencv", "opengl"]
DepthAlong = Literal["axis", "ray"]
GreySource = Literal["image", "cloud", "none"]
Source = Literal["depth image", "organised cloud", "projected cloud"]


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """What the files of a frame do not say themselves."""

    # Length of one unit of depth or of a cloud's coordinates [m]. None: as the calibration says, otherwise millimetres
    # in integer images and metres in floating-point images and clouds.
    scale: float | None = None
    # Stored depths that mean "no measurement", besides NaN, infinities, negative values and depths over 1000 km, which
    # always do. None: 0, and 65535 in integers.
    missing: tuple[float, ...] | None = None
    # What a depth image measures: along the camera's axis, or the distance from its centre along the ray of each pixel.
    depth_along: DepthAlong = "axis"
    fit: Literal["same", "scale"] = (
        "same"  # how the image's size relates to the calibrated one: equal, or scaled as a whole
    )
    image_id: int | None = (
        None  # number of the image in BOP's scene_camera.json; None: the number that the file is named by
    )
    index: int = 0  # number of the frame in a recording; negative ones count from the end
    topic: str | None = None  # topic of depth images or clouds in a recording; None: the only one
    # topic of grey or colour images in a recording, registered to the depth; None: the one that is, if there is one
    grey_topic: str | None = None
    axes: Axes = "opencv"  # axes of a cloud: OpenCV's (y down, z forward) or OpenGL's (y up, z backward)
    grid: tuple[int, int] | None = None  # columns and rows of an organised cloud whose file does not state them
    project: bool = False  # project an organised cloud into the stated camera, as unorganised ones are
    crop: tuple[int, int, int, int] | None = None  # part of the image to keep: u0, v0, width, height [px]
    quarter_turns: int = 0  # anticlockwise quarter turns of the image, after the crop

    def __post_init__(self) -> None:
        if self.scale is not None:
            require_length("scale", self.scale, " (--depth-scale on the command line)")
        if self.fit not in ("same", "scale"):
            raise ValueError(f"fit must be 'same' or 'scale', got {self.fit!r}")
        if self.depth_along not in ("axis", "ray"):
            raise ValueError(f"depth_along must be 'axis' or 'ray', got {self.depth_along!r}")
        if self.axes not in ("opencv", "opengl"):
            raise ValueError(f"axes must be 'opencv' or 'opengl', got {self.axes!r}")
        if self.missing is not None and not (isinstance(self.missing, tuple | list) and _are(Real, *self.missing)):
            raise ValueError(f"missing must be a tuple of numbers, such as (0, 65535), got {self.missing!r}")
        if self.crop is not None and not (len(self.crop) == 4 and _are(Real, *self.crop)):
            raise ValueError(f"crop must be (u0, v0, width, height) in pixels, got {self.crop}")
        if self.grid is not None and not (len(self.grid) == 2 and _are(Integral, *self.grid) and min(self.grid) > 0):
            raise ValueError(f"grid must be columns and rows, two positive whole numbers, got {self.grid}")
        for name in ("index", "quarter_turns", "image_id"):
            value = getattr(self, name)
            if not (_are(Integral, value) or (name == "image_id" and value is None)):
                raise ValueError(f"{name} must be a whole number, got {value!r}")

    def require_use(self, *, cloud: bool, recording: bool) -> None:
        """Check that every option that was set has a meaning for a frame.

        Args:
            cloud: Whether the frame is a cloud rather than a depth image.
            recording: Whether it is from a recording.

        Raises:
            ValueError: An option has none; the message names it.
        """
        about = {
            "recordings": ("a file of one frame", not recording, ("index", "topic", "grey_topic")),
            "clouds": ("a depth image", not cloud, ("axes", "grid", "project")),
            "depth images": ("a cloud", cloud, ("missing", "depth_along")),
        }
        for kind, (got, useless, names) in about.items():
            for name in names if useless else ():
                if getattr(self, name) != getattr(ReadOptions, name):
                    raise ValueError(
                        f"{name} (--{name.replace('_', '-')} on the command line) must come with {kind}, got {got}: "
                        "leave it out"
                    )


def _are(kind: type, *values: object) -> bool:
    """Return whether all values are numbers of a kind; truth values are none."""
    return all(isinstance(value, kind) and not isinstance(value, bool) for value in values)


@dataclass(frozen=True, kw_only=True)
class ReadReport:
    """What the reading of a frame found and did.

    Attributes:
        source: Kind of file. A projected cloud has no grid of pixels of its own: holes and edges are those of its
            projection.
        grey: Where the grey image is from: an image, or the colours of the cloud; "none" if there is none, or one of
            zeros.
        K_recovered: Whether the camera matrix was recovered from the cloud.
        K_residual: Root mean square distance between the pixels of an organised cloud and the projections of its points
            [px]; None for other sources.
        undistorted: Whether lens distortion was removed.
        measured_fraction: Share of the pixels that have a depth.
        unseen_points: Points of a projected cloud that are hidden by others or outside the image.
    """

    source: Source
    grey: GreySource
    K_recovered: bool = False
    K_residual: float | None = None
    undistorted: bool = False
    measured_fraction: float = 0.0
    unseen_points: int = 0
