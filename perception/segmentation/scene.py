"""A labelled scene of boundary points, and its file."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception.boundary import BoundaryCloud
from perception.geometry import Floats, pixel_rays, require_rigid, require_shape
from perception.runtime.records import RecordError, RecordFormat
from perception.segmentation.surface import Surface
from perception.shape import shape_values

SCENES_NOTE = "scenes.json"  # file beside the scenes of a folder with the settings that made them
SURFACE_UNIT = 2e-5  # resolution of the depth of the surface in a file [m]
# Kinds of the data types that a file holds, as numpy names them: u and i whole numbers, f floating point, U text.
_KINDS = {
    **{"tangents": "i", "pixels": "i", "instance_ids": "i", "linearity": "u", "surface": "u", "part": "U"},
    **dict.fromkeys(
        ("d_max", "depth", "surface_frame", "K", "T_cam_parts", "centres_cam", "visible_fractions", "signature"), "f"
    ),
}
FARTHEST = 65535 * SURFACE_UNIT  # largest depth of the surface in a file [m]


class SceneError(RecordError):
    """A file does not hold a complete scene of this version."""


FORMAT = RecordFormat(kind="scene", version=1, remedy="generate_scenes makes scenes", error=SceneError)


@dataclass(frozen=True, eq=False, kw_only=True)
class BoundaryScene:
    """The boundary points of a bin of identical parts, and the ground truth.

    Attributes:
        part: Name of the part.
        d_max: Largest extent of the part [m].
        boundary: Boundary points of the frame.
        surface: Coarse surface of the same frame.
        K: (3, 3) camera matrix [px].
        instance_ids: (N,) int64 part that each boundary point lies on, -1 for the container.
        T_cam_parts: (P, 4, 4) true poses; part i has id i.
        centres_cam: (P, 3) true centres of the parts in the camera frame [m].
        visible_fractions: (P,) visible fraction of each part in [0, 1].
        signature: (6,) invariants of the part's shape [m], see :func:`perception.shape.shape_signature`; None if they
            are unknown, as in scenes of older versions.
    """

    part: str
    d_max: float
    boundary: BoundaryCloud
    surface: Surface
    K: Floats
    instance_ids: NDArray[np.int64]
    T_cam_parts: Floats
    centres_cam: Floats
    visible_fractions: Floats
    signature: Floats | None = None

    def __post_init__(self) -> None:
        require_shape("instance_ids", self.instance_ids, (len(self.boundary),))
        parts = len(self.T_cam_parts)
        require_shape("T_cam_parts", self.T_cam_parts, (parts, 4, 4))
        require_shape("centres_cam", self.centres_cam, (parts, 3))
        require_shape("visible_fractions", self.visible_fractions, (parts,))
        if self.instance_ids.max(initial=-1) >= parts:
            raise ValueError(f"instance_ids go up to {self.instance_ids.max()}, but there are {parts} parts")
        if self.instance_ids.min(initial=-1) < -1:
            raise ValueError(f"instance_ids must be -1 or the number of a part, got {self.instance_ids.min()}")
        if not self.d_max > 0:
            raise ValueError(f"d_max must be positive, got {self.d_max}")
        if self.signature is not None:
            shape_values(self.signature)  # refuses what is no signature

    @property
    def shape(self) -> Floats | None:
        """Return the (5,) values that describe the part's shape, see :func:`perception.shape.shape_values`."""
        return None if self.signature is None else shape_values(self.signature)

    def save(self, path: Path) -> None:
        """Write a compressed file, atomically.

        Raises:
            ValueError: The surface lies farther away than the 16 bits of the file can express.

        Note:
            Points are stored as pixel and float32 depth, tangents and linearity in 8 bits, the surface in 20 um steps.
        """
        b, s = self.boundary, self.surface
        if s.depth.max(initial=0.0) > FARTHEST:
            raise ValueError(f"a scene file holds depths up to {FARTHEST:.2f} m, the surface has {s.depth.max():.2f} m")
        arrays: dict[str, Any] = {
            "part": np.str_(self.part),
            "d_max": np.float64(self.d_max),
            "pixels": b.pixels.astype(np.int16),
            "depth": b.points_cam[:, 2].astype(np.float32),
            "tangents": np.round(b.tangents_cam * 127).astype(np.int8),
            "linearity": np.round(b.linearity * 255).astype(np.uint8),
            "surface": np.round(s.depth / SURFACE_UNIT).astype(np.uint16),
            "surface_frame": np.array([s.u0, s.v0, s.cell], np.float64),
            "K": self.K,
            "instance_ids": self.instance_ids.astype(np.int16),
            "T_cam_parts": self.T_cam_parts,
            "centres_cam": self.centres_cam,
            "visible_fractions": self.visible_fractions,
        }
        if self.signature is not None:
            arrays["signature"] = self.signature
        FORMAT.save_arrays(path, arrays)

    @classmethod
    def load(cls, path: Path) -> "BoundaryScene":
        """Read a scene.

        Raises:
            SceneError: The file is missing, damaged, or of another kind or version.
        """
        return FORMAT.load_arrays(path, cls._from_arrays)

    @classmethod
    def _from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> "BoundaryScene":
        _require_stored(arrays)
        tangents = arrays["tangents"] / 127.0
        lengths = np.linalg.norm(tangents, axis=1, keepdims=True)
        u0, v0, cell = arrays["surface_frame"].tolist()
        surface = Surface(depth=arrays["surface"] * np.float32(SURFACE_UNIT), u0=u0, v0=v0, cell=cell)
        K, depth, pixels = arrays["K"], arrays["depth"].astype(np.float64), arrays["pixels"].astype(np.int64)
        return cls(
            part=str(arrays["part"]),
            d_max=float(arrays["d_max"]),
            boundary=BoundaryCloud(
                points_cam=pixel_rays(K, pixels) * depth[:, None],
                tangents_cam=np.divide(tangents, lengths, out=np.zeros_like(tangents), where=lengths > 0),
                linearity=arrays["linearity"] / 255.0,
                pixels=pixels,
            ),
            surface=surface,
            K=K,
            instance_ids=arrays["instance_ids"].astype(np.int64),
            T_cam_parts=arrays["T_cam_parts"],
            centres_cam=arrays["centres_cam"],
            visible_fractions=arrays["visible_fractions"],
            signature=arrays.get("signature"),
        )

    def only(self, mask: NDArray[np.bool_]) -> "BoundaryScene":
        """Return the scene with only the boundary points of the (N,) ``mask``."""
        return replace(self, boundary=self.boundary.only(mask), instance_ids=self.instance_ids[mask])


def _require_stored(arrays: dict[str, NDArray[Any]]) -> None:
    """Refuse the arrays of a file that :meth:`BoundaryScene.save` has not written: other types, no numbers, no poses.

    Raises:
        KeyError: An array is missing.
        ValueError: An array is of another type, or its values have no meaning.
    """
    for name, kind in _KINDS.items():
        if name == "signature" and name not in arrays:
            continue  # a file of an older version
        array = arrays[name]
        if array.dtype.kind != kind:
            raise ValueError(f"{name} is of type {array.dtype}, which no scene has")
        if kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite")
    require_shape("K", arrays["K"], (3, 3))
    if not (arrays["K"][0, 0] > 0 and arrays["K"][1, 1] > 0):
        raise ValueError(f"K must have positive focal lengths, got {arrays['K'].tolist()}")
    for T_cam_part in arrays["T_cam_parts"]:
        require_rigid("T_cam_parts", T_cam_part)
    fractions = arrays["visible_fractions"]
    if not ((fractions >= 0) & (fractions <= 1)).all():
        raise ValueError(f"visible_fractions must be in [0, 1], got {fractions.tolist()}")
