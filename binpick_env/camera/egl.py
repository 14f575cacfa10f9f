"""The GL backend: depth and ids from one offscreen render through EGL, one context per process."""

import atexit
import copy
import importlib
import os
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from binpick_env.camera.view import VISIBLE, Hits, View
from perception.geometry import Floats

NEAR_CLIP, FAR_CLIP = 0.05, 5.0  # clipping planes [m]; the depth buffer is hyperbolic between them
# OpenCV looks along +z with y down, GL along -z with y up: the one place where the camera is turned.
_GL_FORWARD, _GL_UP = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])

_owner: "EglRenderer | None" = None  # renderer that holds this process's context; a second one corrupts the first


class NearPlane(NamedTuple):
    """What the image covers of the near clipping plane; x points right and y up from the optical axis [m]."""

    centre: float  # x of its middle
    half_width: float
    bottom: float  # y of its lower edge
    top: float  # y of its upper edge


def near_plane(view: View) -> NearPlane:
    """Return what the image of a pinhole camera covers of the near clipping plane.

    Pixel i spans i - 0.5 to i + 0.5, as in ``geometry.camera_matrix``, so the image spans -0.5 to width - 0.5.
    """
    fx, fy, cx, cy = view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2]
    return NearPlane(
        centre=float(NEAR_CLIP * ((view.width - 1) / 2 - cx) / fx),
        half_width=float(NEAR_CLIP * view.width / 2 / fx),
        bottom=float(-NEAR_CLIP * (view.height - 0.5 - cy) / fy),
        top=float(NEAR_CLIP * (cy + 0.5) / fy),
    )


class EglRenderer:
    """Renders a model's visible geoms; the first render makes the GL context, and closes any other renderer's."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._model = copy.copy(model)
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = width, height
        self._model.vis.quality.offsamples = 0  # averaging ids over an edge makes new ids
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = np.arange(mujoco.mjNGROUP) == VISIBLE
        self._option.sitegroup[:] = 0
        self._scene: mujoco.MjvScene | None = None
        self._context: mujoco.MjrContext | None = None
        self._gl: object | None = None

    def render(self, data: mujoco.MjData, view: View, T_world_cam: Floats) -> Hits:
        """Return depth and geoms of the view's region; the normals are left at 0."""
        self._open()
        camera = mujoco.MjvCamera()
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        self._aim(view, T_world_cam)
        self._gl.make_current()  # type: ignore[union-attr]
        mujoco.mjr_render(self._rect, self._scene, self._context)
        colours = np.empty((view.height, view.width, 3), np.uint8)
        inverse = np.empty((view.height, view.width), np.float32)
        mujoco.mjr_readPixels(colours, inverse, self._rect, self._context)
        return self._decode(view, colours[::-1], inverse[::-1])

    def close(self) -> None:
        """Free the GL context, if this renderer holds it; the next render makes another."""
        global _owner
        if self._context is not None:
            self._context.free()
        if self._gl is not None:
            self._gl.free()  # type: ignore[attr-defined]
        self._context = self._gl = self._scene = None
        if _owner is self:
            _owner = None

    def _open(self) -> None:
        global _owner
        if _owner is self:
            return
        if _owner is not None:
            _owner.close()
        self._gl = _gl_context(self._rect.width, self._rect.height)
        atexit.unregister(_close)
        atexit.register(_close)  # after mujoco.egl's own registration, so that it runs before EGL is shut down
        _owner = self
        self._gl.make_current()  # type: ignore[attr-defined]
        self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR.value
        self._scene = mujoco.MjvScene(self._model, maxgeom=self._model.ngeom + 100)
        for flag in range(mujoco.mjtRndFlag.mjNRNDFLAG.value):
            self._scene.flags[flag] = flag in (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR)

    def _aim(self, view: View, T_world_cam: Floats) -> None:
        """Set pose and frustum of the scene's cameras; GL renders the same view for both eyes."""
        frustum = near_plane(view)
        for camera in self._scene.camera:  # type: ignore[union-attr]
            camera.pos = T_world_cam[:3, 3]
            camera.forward = T_world_cam[:3, :3] @ _GL_FORWARD
            camera.up = T_world_cam[:3, :3] @ _GL_UP
            camera.orthographic = 0
            camera.frustum_near, camera.frustum_far = NEAR_CLIP, FAR_CLIP
            camera.frustum_center, camera.frustum_width = frustum.centre, frustum.half_width
            camera.frustum_top, camera.frustum_bottom = frustum.top, frustum.bottom

    def _decode(self, view: View, colours: NDArray[np.uint8], inverse: NDArray[np.float32]) -> Hits:
        """Turn id colours and the reversed depth buffer (1 at NEAR_CLIP, 0 at FAR_CLIP, linear in 1 / z) into hits."""
        hits = Hits.empty(view)
        u0, v0, u1, v1 = view.region
        box = np.s_[v0:v1, u0:u1]
        place = colours[box].astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        geom_of_place = np.full(self._scene.ngeom + 1, -1, np.int32)  # type: ignore[union-attr]
        for item in self._scene.geoms[: self._scene.ngeom]:  # type: ignore[union-attr]
            if item.segid >= 0 and item.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                geom_of_place[item.segid + 1] = item.objid
        hits.geom_at[box] = geom_of_place[place]
        depth = 1.0 / (1.0 / FAR_CLIP + inverse[box].astype(np.float64) * (1.0 / NEAR_CLIP - 1.0 / FAR_CLIP))
        hits.depth[box] = np.where(hits.geom_at[box] >= 0, depth, 0.0)
        return hits


def _gl_context(width: int, height: int) -> object:
    """Return MuJoCo's EGL context, whatever MUJOCO_GL chose for other windows.

    Raises:
        RuntimeError: Where there is no working EGL.
    """
    before = os.environ.get("PYOPENGL_PLATFORM")
    try:
        os.environ["PYOPENGL_PLATFORM"] = "egl"
        return importlib.import_module("mujoco.egl").GLContext(width, height)
    except Exception as error:  # PyOpenGL raises anything, from AttributeError to its own GLError
        raise RuntimeError(
            f"backend 'egl' needs a working EGL driver (apt-get install libegl1 libgl1-mesa-dri), and there is none "
            f"({error}); backends 'rays' and 'raster' need no GL"
        ) from error
    finally:
        if before is None:
            os.environ.pop("PYOPENGL_PLATFORM", None)
        else:
            os.environ["PYOPENGL_PLATFORM"] = before


def _close() -> None:
    if _owner is not None:
        _owner.close()
