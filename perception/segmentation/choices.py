"""Kinds of segmentation networks, as names that a user chooses among. It loads nothing, so that commands start fast."""

from typing import Literal

# The image-plane network; the paper's network; EdgeConvs with the context of parts around. The last two need points
# alone.
NetworkName = Literal["grid", "dgcnn-sgpn", "dgcnn-context"]
