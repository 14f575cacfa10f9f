"""The perception of one part in frames, within a bin whose pose is known or without any."""

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from perception.bin import BinFit, find_bin
from perception.bin.unit import bin_words
from perception.boundary import BoundarySettings
from perception.diagnosis import (
    ABOUT_BIN,
    BinFacts,
    bin_size_cause,
    log_causes,
    no_bin_cause,
    swapped_centre_cause,
)
from perception.frame import Frame, Workspace
from perception.geometry import Floats, make_transform, rotation_about
from perception.part import PartModel
from perception.pipeline import Perception, Pipeline
from perception.pose.estimator import PoseEstimator
from perception.segmentation.choices import NetworkName
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.weights import find_weights
from policies.frames.bin_settings import BinSettings, workspace_found

FARTHEST = 20.0  # depth beyond which nothing is searched without a bin; no camera over parts measures it [m]
NO_DEPTH = (0.5, 1.0)  # range that is searched in a frame without depth, where there is nothing to find [m]


@dataclass(frozen=True, kw_only=True)
class UsedWeights:
    """Weights of the segmentation network.

    Attributes:
        name: File name.
        sha256: Digest of the file.
        training: "own" if the network was trained on the part, "family" if on parts of its family, else "zero-shot".
    """

    name: str
    sha256: str
    training: str


class FramePerceiver:
    """Finds the poses of one part in frames.

    Attributes:
        part: Part that is searched for.
        workspace: The bin as it is believed to be; None if nothing is known of its place, or no bin limits the poses.
        bin: How the bin in the frames is known.
        weights: Weights of the segmentation network.
        predictor: Segmentation of boundary points.
        estimator: Pose estimation of segments.
        origin_in_file: Position of the part frame's origin in the frame of the part's file [m].
    """

    def __init__(
        self,
        part: PartModel,
        workspace: Workspace | None,
        *,
        origin_in_file: tuple[float, float, float] = (0.0, 0.0, 0.0),
        bin: BinSettings | None = None,
        network: NetworkName = "grid",
    ) -> None:
        """Load the network and the models of the part, which take seconds the first time.

        Args:
            part: Part to search for.
            workspace: The bin as it is believed to be; None to look for it, or to search all that a frame measures.
            origin_in_file: Position of the part frame's origin in the frame of the part's file [m]; records name it.
            bin: How the bin in the frames is known; the defaults of :class:`BinSettings` if None.
            network: Kind of the segmentation network.

        Raises:
            WeightsError: There are neither weights of the part nor for every part, of this kind.
            ValueError: The part does not fit into the bin.
        """
        bin = bin or BinSettings()
        _require_room(part, bin.inner_size if workspace is None else workspace.inner_size)
        found = find_weights(part, network)
        digest = hashlib.sha256(found.path.read_bytes()).hexdigest()
        self.part, self.workspace, self.origin_in_file = part, workspace, origin_in_file
        self.bin = bin
        self.weights = UsedWeights(name=found.path.name, sha256=digest, training=found.training)
        self.predictor = SegmentationPredictor.from_file(found.path, part=part)
        self.estimator = PoseEstimator(part, workspace=workspace)

    def perceive(self, frame: Frame) -> Perception:
        """Return the poses in a frame; none where nothing is found.

        Raises:
            ValueError: No bin was given and the depth is no camera's over parts, or the part is too small in the image,
                or larger than all that is measured.
        """
        if self.workspace is not None:
            pipeline = Pipeline(
                self.predictor, self.estimator, self.workspace, measure_bin=self.bin.measure, trust=self.bin.trust
            )
            return pipeline.perceive(frame)
        return _with_camera(self._perceive_anywhere(frame), frame)

    def _perceive_anywhere(self, frame: Frame) -> Perception:
        """Return the poses in a frame of a bin whose place is not known, or without any."""
        fit = find_bin(frame, self.bin.inner_size) if self.bin.find else None
        if fit is not None and fit.reliable:
            workspace = workspace_found(frame, fit)
            seen = self._perceive(self.estimator.within(workspace), frame, workspace)
            return _with_bin(seen, fit, self.bin.inner_size)
        region = workspace_of_depth(frame)
        self._require_space(region, fit)
        seen = self._perceive(self.estimator, frame, region)
        if seen.report is not None:
            causes = tuple(cause for cause in seen.report.causes if cause.name not in ABOUT_BIN)
            seen = replace(seen, report=replace(seen.report, causes=causes, region=True))
        return seen if fit is None else _with_bin(seen, fit, self.bin.inner_size)

    def _require_space(self, region: Workspace, fit: BinFit | None) -> None:
        """Raise ``ValueError`` if the part does not fit into all that a frame measures."""
        d_max = self.part.d_max
        if d_max <= np.linalg.norm(region.inner_size):
            return
        size = " x ".join(f"{1000 * value:.0f}" for value in region.inner_size)
        unseen = "" if fit is None else f"the bin was not measured ({fit.reason}), and "
        raise ValueError(
            f"{unseen}the part must fit into what the frame measures, got a part of {1000 * d_max:.0f} mm and a region "
            f"of {size} mm: check the depth's unit (--depth-scale), or that of the part's file (--unit)"
        )

    def _perceive(self, estimator: PoseEstimator, frame: Frame, workspace: Workspace) -> Perception:
        """Return the poses in a frame of a bin that is taken as it is."""
        return Pipeline(self.predictor, estimator, workspace, measure_bin=False).perceive(frame)


def _require_room(part: PartModel, inner_size: Floats | None) -> None:
    """Raise ``ValueError`` if a part does not fit into a bin of (3,) inner size [m]; None is any bin."""
    if inner_size is None or part.d_max <= (longest := float(np.linalg.norm(inner_size))):
        return
    words = bin_words(1000 * np.asarray(inner_size), without="millimetres")
    raise ValueError(
        f"the part must fit into the bin, got a part of {1000 * part.d_max:.4g} mm and a bin whose diagonal is "
        f"{1000 * longest:.4g} mm: check --bin and --unit"
        + (f"; --bin in one word is millimetres: type {words}" if words else "")
    )


def _with_bin(seen: Perception, fit: BinFit, size_given: Floats | None) -> Perception:
    """Return what was found with the bin that was looked for, and why it may not be the one of the (3,) given size."""
    report = seen.report
    if report is not None:
        causes = report.causes
        if size_given is not None:
            cause = bin_size_cause(fit, size_given, causes)
            if cause is None and not (causes or seen.poses or fit.reliable or np.isfinite(fit.opening).any()):
                cause = no_bin_cause(size_given)
            causes = causes if cause is None else (cause, *causes)
        report = replace(report, bin=BinFacts.of(fit, None, size_given), causes=causes)
        log_causes(report)
    return replace(seen, bin=fit, report=report)


def _with_camera(seen: Perception, frame: Frame) -> Perception:
    """Return what was found, and whether the frame's camera matrix can be right, where no bin's place tells it."""
    cause, report = swapped_centre_cause(frame, None), seen.report
    if cause is None or report is None or any(each.name == cause.name for each in report.causes):
        return seen
    report = replace(report, causes=(cause, *report.causes))
    log_causes(report)
    return replace(seen, report=report)


def workspace_of_depth(frame: Frame) -> Workspace:
    """Return the box of all that a frame measures, to search where no bin is known.

    The box spans the whole image at the largest depth, and its z axis points at the camera. It is larger than the
    measurements by the margin within which boundary points would count as the bin's own, so that none is lost.

    Args:
        frame: Frame of the camera.

    Raises:
        ValueError: The largest depth exceeds 20 m.
    """
    depths = frame.depth[frame.valid]
    near, far = (float(depths.min()), float(depths.max())) if len(depths) else NO_DEPTH
    if far > FARTHEST:
        raise ValueError(
            f"without a bin, depths must be at most {FARTHEST:g} m, got {far:.4g} m: set --depth-scale (0.001 for "
            "millimetres) or name the values that mean no measurement by --missing"
        )
    margin = 2 * BoundarySettings().margin
    height, width = frame.depth.shape
    corners = far * (np.array([[0, 0], [width - 1, height - 1]]) - frame.K[:2, 2]) / np.diag(frame.K)[:2]
    middle, size = corners.mean(axis=0), np.ptp(corners, axis=0)
    over = rotation_about((1.0, 0.0, 0.0), np.pi)  # the bin's z axis points at the camera
    T_cam_bin = make_transform(over, np.array([*middle, far + margin]))
    inner_size = np.array([*(size + 2 * margin), far - near + 2 * margin])
    return Workspace(T_world_bin=frame.T_world_cam @ T_cam_bin, inner_size=inner_size)
