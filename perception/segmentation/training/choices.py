"""How networks are trained, as names that a user chooses among; `presets` says what they stand for."""

from typing import Literal

PresetName = Literal["paper", "released", "ours", "dgcnn-context", "dgcnn-sgpn"]
