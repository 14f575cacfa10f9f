"""Names that the command line offers; it loads nothing heavy."""

from typing import Literal

SoakKind = Literal["env", "select", "fuzz", "kill", "load"]
