"""Outputs of every segmentation network for every point.

Shapes: B clouds of a batch, N points, C coordinates of a point, F dimensions of the embedding, S semantic classes.
"""

from typing import NamedTuple

from torch import Tensor


class PointOutputs(NamedTuple):
    """Outputs of the heads.

    Attributes:
        embedding_BNF: Embedding (F_SIM of the paper), in which points of one instance lie close together.
        confidence_BN: Expected IoU of the group that each point proposes, in (0, 1).
        semantics_BNS: Class logits.
        offsets_BN3: Offset from each point to the centre of its part, in units of d_max; None for networks without that
            head.
    """

    embedding_BNF: Tensor
    confidence_BN: Tensor
    semantics_BNS: Tensor
    offsets_BN3: Tensor | None = None
