"""Settings of the pose estimator: what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.perception.pose.estimator_scene import CONFIG


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rough_hypotheses": 0}, "rough_hypotheses must be at least 1, got 0"),
        ({"contending": -1.0}, "contending must be at least 0, got -1.0"),
        ({"contending": np.nan}, "contending must be at least 0, got nan"),
        ({"hypotheses": 0}, "hypotheses must be at least 1, got 0"),
        ({"most_hypotheses": 0}, "most_hypotheses must be at least 1, got 0"),
        ({"most_hypotheses": 2}, "most_hypotheses must be at least 4, got 2"),
        ({"sure": 90.0}, r"sure must be in \[0, 1\], got 90.0"),
        ({"finalists": -1}, "finalists must be at least 1, got -1"),
        ({"scene_hypotheses": 0}, "scene_hypotheses must be at least 1, got 0"),
        ({"min_score": 1.1}, r"min_score must be in \[0, 1\], got 1.1"),
        ({"min_score": np.nan}, r"min_score must be in \[0, 1\], got nan"),
    ],
)
def test_nonsense_in_the_config_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(CONFIG, **change)
