"""What a grammar is: it draws one input, and returns the call that gives it to the product."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from policies.soak.fuzz.samples import Samples

Case = Callable[[], object]
Grammar = Callable[[np.random.Generator, "Samples", Path], Case]  # the folder is empty, and the case's alone
