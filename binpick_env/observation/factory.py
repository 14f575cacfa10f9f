"""The perceiver that a name stands for."""

from typing import get_args

from binpick_env.config import CameraConfig, Perception
from binpick_env.observation.noisy_oracle import NoisyOraclePerceiver
from binpick_env.observation.oracle import OraclePerceiver, PoseNoise
from binpick_env.observation.perceiver import Perceiver
from binpick_env.observation.perception_noise import PerceptionNoise
from binpick_env.parts.part import Part
from perception.frame import Workspace
from perception.part import PartModel
from perception.segmentation.choices import NetworkName


def make_perceiver(
    mode: str,
    part: PartModel,
    workspace: Workspace,
    noise: PoseNoise | PerceptionNoise | None = None,
    threads: int | None = None,
    network: NetworkName = "grid",
) -> Perceiver:
    """Build the perceiver called ``mode``.

    Args:
        mode: ``"oracle"`` for true poses, ``"gt_masks"`` for true segments and estimated poses, ``"learned"`` for the
            segmentation network and estimated poses.
        part: Part to be recognised. The models of its edges and its surface take seconds the first time.
        workspace: Pose and inner box of the bin.
        noise: Errors of the oracle's poses: Gaussian of a stated size, or such as the learned perceiver makes.
        threads: Number of threads that torch and OpenCV may use while a pixel perceiver works; None changes nothing.
        network: Kind of the segmentation network under ``"learned"``.

    Raises:
        ValueError: There is no such mode or network, or the part's mesh does not enclose a volume.
        WeightsError: (a ValueError) ``"learned"`` has no weights for the part; the text names the commands that make
            them and the other modes.
    """
    if mode not in get_args(Perception):
        raise ValueError(f"perception must be one of {', '.join(get_args(Perception))}, got {mode!r}")
    if network not in get_args(NetworkName):
        raise ValueError(f"network must be one of {', '.join(get_args(NetworkName))}, got {network!r}")
    if mode == "oracle":
        return NoisyOraclePerceiver(noise) if isinstance(noise, PerceptionNoise) else OraclePerceiver(noise)
    # Imported here: the pose estimator's kernels and torch take seconds to load, and the oracle uses neither.
    from binpick_env.observation.pixel_perceiver import gt_masks_perceiver, learned_perceiver

    if mode == "gt_masks":
        return gt_masks_perceiver(part, workspace, threads)
    return learned_perceiver(part, workspace, threads, network)


def resolve_noise(
    noise: PoseNoise | PerceptionNoise | str | None, part: Part, sensor: str, camera: CameraConfig
) -> PoseNoise | PerceptionNoise | None:
    """Return the oracle's errors; ``"learned"`` stands for those of the learned perceiver on this part and sensor.

    Args:
        noise: Errors as an environment is given them.
        part: Part in the bin.
        sensor: Preset of the depth sensor's noise.
        camera: Camera, which determines the size of the part in the image.

    Raises:
        ValueError: ``noise`` is nothing of the kind.
    """
    if noise is None or isinstance(noise, PoseNoise | PerceptionNoise):
        return noise
    if noise != "learned":
        raise ValueError(f"pose_noise must be a PoseNoise, a PerceptionNoise or 'learned', got {noise!r}")
    return PerceptionNoise.for_part(part, sensor, camera)
