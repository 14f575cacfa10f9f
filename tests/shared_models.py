"""Models of a mesh are computed once per test process: many tests build a cell of the same robot and part."""

import hashlib
import pickle
from collections.abc import Callable
from functools import cache
from typing import Any

MOST = 64  # results that are kept of each function


@cache
def share_models() -> None:
    """Let cells share their meshes' triangles with normals, and estimators of a part its pair table."""
    from binpick_env.camera import raster
    from perception.pose import estimator

    for module, name in ((raster, "_soup"), (estimator, "build_table")):
        setattr(module, name, remembered(getattr(module, name)))


@cache
def share_shaded_meshes() -> None:
    """Let recordings share the shaded meshes of the robot and the part."""
    from policies.report import recording_scene

    recording_scene.shaded_mesh = remembered(recording_scene.shaded_mesh)


def remembered(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that computes its result once for equal arguments; callers must not change the result."""
    results: dict[bytes, Any] = {}

    def remember(*arguments: Any, **named: Any) -> Any:
        key = hashlib.sha256(pickle.dumps((arguments, named))).digest()
        result = results.pop(key) if key in results else function(*arguments, **named)
        results[key] = result  # the last used one is the last to go
        if len(results) > MOST:
            del results[next(iter(results))]
        return result

    return remember
