"""Equal meshes are cut into convex pieces once for all tests of a file: CoACD runs in a process of its own."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest
import trimesh

from binpick_env.parts import pieces
from binpick_env.parts.decomposition import decompose
from perception.geometry import Floats
from tests.shared_models import remembered


@pytest.fixture(autouse=True, scope="module")
def _cuts_are_shared() -> Iterator[None]:
    @remembered
    def cut(vertices: Floats, faces: Any, settings: dict[str, Any], **options: Any) -> list[Floats]:
        return decompose(trimesh.Trimesh(vertices, faces, process=False), settings, **options)

    def shared(mesh: trimesh.Trimesh, settings: Mapping[str, Any], **options: Any) -> list[Floats]:
        return cut(np.asarray(mesh.vertices), np.asarray(mesh.faces), dict(settings), **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pieces, "decompose", shared)
        yield
