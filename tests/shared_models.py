"""Models of a mesh are computed once per test process: many tests build a cell of the same robot and part."""

import hashlib
import pickle
from collections.abc import Callable
from functools import cache
from typing import Any

from tests.memory import FORGETTABLE, trimmed_after

MOST = 64  # results that are kept of each function


@cache
def share_models() -> None:
    """Let cells share their meshes' triangles with normals, and estimators of a part its pair table."""
    from binpick_env.camera import raster
    from binpick_env.cell import simulation
    from perception.pose import estimator

    raster._soup = remembered(raster._soup)
    estimator.build_table = remembered(estimator.build_table, forgettable=True)
    made = simulation.Simulation
    made.__init__ = trimmed_after(made.__init__)  # type: ignore[method-assign]


@cache
def share_shaded_meshes() -> None:
    """Let recordings share the shaded meshes of the robot and the part."""
    from policies.report import recording_scene

    recording_scene.shaded_mesh = remembered(recording_scene.shaded_mesh, forgettable=True)


def remembered(function: Callable[..., Any], *, forgettable: bool = False) -> Callable[..., Any]:
    """Return a function that computes its result once for equal arguments; callers must not change the result.

    Args:
        function: Function of arguments that can be pickled.
        forgettable: Whether a process that is not small forgets the results.
    """
    results: dict[bytes, Any] = {}
    if forgettable:
        FORGETTABLE.append(results)

    def remember(*arguments: Any, **named: Any) -> Any:
        key = hashlib.sha256(pickle.dumps((arguments, named))).digest()
        result = results.pop(key) if key in results else function(*arguments, **named)
        results[key] = result  # the last used one is the last to go
        if len(results) > MOST:
            del results[next(iter(results))]
        return result

    return remember
