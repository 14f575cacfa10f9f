"""Backends and a pile, built once for each file of tests."""

import pytest

from tests.binpick_env.camera.camera_scene import Scene, build, random_poses
from tests.binpick_env.camera.camera_views import BACKENDS, WORKSPACE, egl_works


@pytest.fixture(scope="module", params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> str:
    if request.param == "egl" and not egl_works():
        pytest.skip("no EGL driver on this machine (libegl1, libgl1-mesa-dri)")
    return request.param


@pytest.fixture(scope="module")
def pile() -> Scene:
    return build(random_poses(8, WORKSPACE, seed=1))
