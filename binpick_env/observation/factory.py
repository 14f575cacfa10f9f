"""The perceiver that a name stands for."""

from typing import get_args

from binpick_env.config import Perception
from binpick_env.observation.noisy_oracle import NoisyOraclePerceiver
from binpick_env.observation.oracle import OraclePerceiver, PoseNoise
from binpick_env.observation.perceiver import Perceiver
from binpick_env.observation.perception_noise import PerceptionNoise
from perception.frame import Workspace
from perception.part import PartModel


def make_perceiver(
    mode: str,
    part: PartModel,
    workspace: Workspace,
    noise: PoseNoise | PerceptionNoise | None = None,
    threads: int | None = None,
) -> Perceiver:
    """Build the perceiver called ``mode``.

    Args:
        mode: ``"oracle"`` for true poses, ``"gt_masks"`` for true segments and estimated poses, ``"learned"`` for the
            segmentation network and estimated poses.
        part: Part to be recognised. The models of its edges and its surface take seconds the first time.
        workspace: Pose and inner box of the bin.
        noise: Errors of the oracle's poses: Gaussian of a stated size, or such as the learned perceiver makes.
        threads: Number of threads that torch and OpenCV may use while a pixel perceiver works; None changes nothing.

    Raises:
        ValueError: There is no such mode, or the part's mesh does not enclose a volume.
        WeightsError: (a ValueError) ``"learned"`` has no weights for the part; the text names the commands that make
            them and the other modes.
    """
    if mode not in get_args(Perception):
        raise ValueError(f"perception must be one of {', '.join(get_args(Perception))}, got {mode!r}")
    if mode == "oracle":
        return NoisyOraclePerceiver(noise) if isinstance(noise, PerceptionNoise) else OraclePerceiver(noise)
    # Imported here: the pose estimator's kernels and torch take seconds to load, and the oracle uses neither.
    from binpick_env.observation.pixel_perceiver import gt_masks_perceiver, learned_perceiver

    build = learned_perceiver if mode == "learned" else gt_masks_perceiver
    return build(part, workspace, threads)
