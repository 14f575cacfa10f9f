"""The segmentation predictor: boundary points in, instances out."""

import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.boundary import BoundaryCloud
from perception.geometry import Floats, require_shape
from perception.instance import Instance, instances_of
from perception.part import PartModel
from perception.segmentation.choices import NetworkName
from perception.segmentation.grouping.similarity import GroupingConfig, group_points, require_finite
from perception.segmentation.networks.context_net import ContextInputs, ContextNet
from perception.segmentation.networks.grid import place_in, view_grid
from perception.segmentation.networks.grid_net import GridInputs, GridNet, shape_input
from perception.segmentation.networks.hierarchy import build_hierarchy, level_order, thin
from perception.segmentation.networks.inputs import centred
from perception.segmentation.networks.output import PointOutputs
from perception.segmentation.networks.precision import half_precision
from perception.segmentation.surface import Surface
from perception.segmentation.weights import Network, find_weights, load_network
from perception.shape import shape_signature, shape_values

_log = logging.getLogger(__name__)
Singles = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class PredictorConfig:
    """Settings of the prediction with a trained network.

    Attributes:
        grouping: Settings of the grouping of points by their embedding.
        subset: Number of points that a network over point sets (the paper's) sees at once.
        bf16: Run the trunk of the image-plane network in bfloat16. The graphs of other networks need full precision.
        seed: Seed of the subsets; the same cloud is always divided in the same way.
    """

    grouping: GroupingConfig = field(default_factory=GroupingConfig)
    subset: int = 4096
    bf16: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        if self.subset < 1:
            raise ValueError(f"subset must be at least 1, got {self.subset}")


@dataclass(frozen=True, eq=False, kw_only=True)
class PointPredictions:
    """Outputs of the network for each of N points.

    Attributes:
        embedding: (N, F) float32 embedding.
        confidence: (N,) float32 confidence in (0, 1).
        offsets: (N, 3) float32 offset from each point to the centre of its part, in units of d_max; None for networks
            without that output.
    """

    embedding: Singles
    confidence: Singles
    offsets: Singles | None


class SegmentationPredictor:
    """Segments all boundary points of a frame.

    A network over point sets sees random subsets, which cover the cloud once. Embeddings of different subsets are
    comparable, so all points are grouped together. The context network sees the cloud thinned to an even density, and
    each point takes the outputs of the nearest one. The image-plane network sees all points at once.
    """

    def __init__(
        self,
        network: Network,
        config: PredictorConfig | None = None,
        device: torch.device | str | None = None,
        part: PartModel | None = None,
    ) -> None:
        """Use a network.

        Args:
            network: Trained network. It is put into evaluation mode and moved to the device.
            config: Settings of the prediction; the defaults of :class:`PredictorConfig` if left out.
            device: Device of the computation; a GPU if there is one, unless given.
            part: Part to recognise. A network that can be told the shape is told it.

        Raises:
            ValueError: The part's mesh does not enclose a volume.
        """
        self.shape = None if part is None else shape_values(shape_signature(part))
        self.config = config or PredictorConfig()
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self.network = network.to(self.device).eval()
        if isinstance(network, GridNet):
            self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @classmethod
    def for_part(
        cls,
        part: PartModel,
        config: PredictorConfig | None = None,
        device: torch.device | str | None = None,
        network: NetworkName = "grid",
    ) -> "SegmentationPredictor":
        """Return the predictor with the weights for a part: its own, or those for every part.

        Args:
            part: Part to recognise. Its shape decides which weights are its own.
            config: Settings of the prediction; the defaults of :class:`PredictorConfig` if left out.
            device: Device of the computation; a GPU if there is one, unless given.
            network: Kind of network.

        Raises:
            WeightsError: There are neither weights of the part nor for every part, of this kind.
        """
        found = find_weights(part, network)
        _log.info("%s is segmented by %s (%s)", part.name, found.path, found.training)
        return cls.from_file(found.path, config, device, part)

    @classmethod
    def from_file(
        cls,
        path: Path,
        config: PredictorConfig | None = None,
        device: torch.device | str | None = None,
        part: PartModel | None = None,
    ) -> "SegmentationPredictor":
        """Return the predictor with the weights of a ``.safetensors`` file; see :meth:`__init__`."""
        _log.info("loading the segmentation network %s", path)
        return cls(load_network(path), config, device, part)

    @property
    def needs_surface(self) -> bool:
        """Whether the network sees the surface besides the points, as the image-plane network does."""
        return isinstance(self.network, GridNet)

    def predict(
        self,
        points: BoundaryCloud | Floats,
        surface: Surface | None = None,
        d_max: float | None = None,
        shape: Floats | None = None,
    ) -> list[Instance]:
        """Return the instances in a frame, best first; none for an empty cloud or one without groups.

        Args:
            points: All boundary points of the frame, or for a network over points their (N, 3) coordinates in the
                camera frame alone [m].
            surface: Coarse surface of the same frame, for the same ``d_max``; only the image-plane network needs it.
            d_max: Largest extent of the part [m]. It must be given.
            shape: (5,) values that describe the part's shape, see :func:`perception.shape.shape_values`. Those of the
                predictor's part unless given.

        Raises:
            ValueError: ``d_max`` is missing or not positive, the points are not finite, or the image-plane network is
                given no surface, no pixels or a surface without depth at the points.
        """
        if d_max is None or not 0 < d_max < np.inf:
            raise ValueError(f"d_max must be positive and finite, got {d_max}")
        if len(points) == 0:
            return []
        outputs = self.describe(points, surface, d_max, shape)
        groups = group_points(outputs.embedding, outputs.confidence, _coordinates(points), d_max, self.config.grouping)
        return instances_of(groups.labels, groups.scores)

    def describe(
        self, points: BoundaryCloud | Floats, surface: Surface | None, d_max: float, shape: Floats | None = None
    ) -> PointPredictions:
        """Return the outputs of the network for all points of a cloud, which must not be empty; see :meth:`predict`."""
        shape = self.shape if shape is None else shape
        with torch.inference_mode():
            if isinstance(self.network, ContextNet):
                return self._thinned(self.network, _coordinates(points), d_max)
            if not self.needs_surface:
                return self._by_subsets(_coordinates(points), d_max)
            if surface is None or not isinstance(points, BoundaryCloud):
                raise ValueError(
                    "the image-plane network needs the pixels and the surface of a frame, got "
                    f"{'a BoundaryCloud' if isinstance(points, BoundaryCloud) else 'points'} and "
                    f"{'no surface' if surface is None else 'a surface'}: a network over points "
                    "(network='dgcnn-context' or 'dgcnn-sgpn') segments points alone"
                )
            with half_precision(self.device, self.config.bf16):
                return self._all_at_once(points, surface, d_max, shape)

    def _all_at_once(
        self, boundary: BoundaryCloud, surface: Surface, d_max: float, shape: Floats | None
    ) -> PointPredictions:
        points, place = boundary.points_cam, place_in(surface, boundary.pixels)
        _require_depth(surface, place)
        reference = float(np.median(points[:, 2]))
        view = view_grid(surface.depth, place, points[:, 2], d_max, reference)
        arrays = (view.cells, view.place, view.local, centred(points, d_max), shape_input(shape))
        inputs = GridInputs(*(torch.from_numpy(array)[None].to(self.device) for array in arrays))
        return _predictions(self.network(inputs))

    def _thinned(self, network: ContextNet, points: Floats, d_max: float) -> PointPredictions:
        config, scaled = network.config, centred(points, d_max)
        chosen = thin(scaled, config.spacing, np.random.default_rng(self.config.seed))
        chosen = chosen[level_order(scaled[chosen], config.spacing)]
        inputs = ContextInputs.of([build_hierarchy(scaled[chosen], config.k)])
        found = _predictions(network(ContextInputs(*(tensor.to(self.device) for tensor in inputs))))
        nearest = cKDTree(scaled[chosen]).query(scaled)[1]
        return PointPredictions(
            embedding=found.embedding[nearest],
            confidence=found.confidence[nearest],
            offsets=None if found.offsets is None else found.offsets[nearest],
        )

    def _by_subsets(self, points: Floats, d_max: float) -> PointPredictions:
        order = np.random.default_rng(self.config.seed).permutation(len(points))
        coordinates = centred(points, d_max)
        found: list[PointPredictions] = []
        for chosen in np.array_split(order, -(-len(points) // self.config.subset)):
            inputs = torch.from_numpy(coordinates[chosen])[None].to(self.device)
            found.append(_predictions(self.network(inputs)))
        back = np.argsort(order)
        return PointPredictions(
            embedding=np.concatenate([f.embedding for f in found])[back],
            confidence=np.concatenate([f.confidence for f in found])[back],
            offsets=None,
        )


def _coordinates(points: BoundaryCloud | Floats) -> Floats:
    """Return the (N, 3) coordinates of points.

    Raises:
        ValueError: Their shape is another one, or they are not finite.
    """
    if isinstance(points, BoundaryCloud):
        return points.points_cam
    coordinates = np.asarray(points, np.float64)
    require_shape("points", coordinates, (None, 3))
    require_finite("points", coordinates)
    return coordinates


def _require_depth(surface: Surface, place: Floats) -> None:
    """Raise a ``ValueError`` unless the surface has a depth in the cell of at least one of the (N, 2) places."""
    rows, columns = surface.depth.shape
    at = np.floor(place).astype(np.int64)
    inside = ((at >= 0) & (at < (columns, rows))).all(axis=1)
    if not (surface.depth[at[inside, 1], at[inside, 0]] > 0).any():
        raise ValueError(
            f"surface must have depths where the boundary points are, got a surface of {rows} x {columns} cells, "
            f"{np.count_nonzero(surface.depth > 0)} of them measured, with a depth at none of {len(place)} points: "
            "coarse_surface makes it from the same frame, and a network over points needs none"
        )


def _predictions(outputs: PointOutputs) -> PointPredictions:
    offsets = outputs.offsets_BN3
    return PointPredictions(
        embedding=outputs.embedding_BNF[0].float().cpu().numpy(),
        confidence=outputs.confidence_BN[0].float().cpu().numpy(),
        offsets=None if offsets is None else offsets[0].float().cpu().numpy(),
    )
