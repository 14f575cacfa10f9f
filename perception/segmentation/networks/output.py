"""What every segmentation network says about every point.

Shapes: B clouds of a batch, N points, C coordinates of a point, F dimensions of the embedding, S semantic classes.
"""

from typing import NamedTuple

from torch import Tensor


class PointOutputs(NamedTuple):
    """The heads' outputs.

    Attributes:
        embedding_BNF: Points of one instance lie close together (F_SIM of the paper).
        confidence_BN: In (0, 1): IoU that the group proposed by this point is expected to have.
        semantics_BNS: Class logits.
        offsets_BN3: From the point to its part's centre in units of d_max; None for networks without that head.
    """

    embedding_BNF: Tensor
    confidence_BN: Tensor
    semantics_BNS: Tensor
    offsets_BN3: Tensor | None = None
