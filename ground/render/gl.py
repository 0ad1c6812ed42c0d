"""OpenGL without a display: whether this machine has it, and a camera that uses it.

The context is made here and not by MUJOCO_GL=egl: on a machine without libEGL that setting breaks the
import of mujoco itself, and it has no effect once mujoco has been imported. Where MUJOCO_GL is set, it rules;
the command line lets only the values through that turn OpenGL off.
"""

import functools
import os
import subprocess
import sys
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

PROBE_TIMEOUT_S = 30.0
PROBE = "from ground.render import gl; gl.draw_something()"
PROBE_MODEL = "<mujoco><worldbody><camera name='eye' pos='0 0 2'/><geom size='1'/></worldbody></mujoco>"


@functools.cache
def unavailable_reason() -> str | None:
    """Say why this machine cannot draw with OpenGL, or None if it can.

    Drawing is tried in a process of its own, once: a broken driver may print, hang or crash.
    """
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        probe = subprocess.run(
            [sys.executable, "-P", "-c", PROBE],
            env=env,
            capture_output=True,
            text=True,
            timeout=PROBE_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        return f"the driver did not answer in {PROBE_TIMEOUT_S:.0f} s"
    except OSError as error:
        return f"the probe did not start: {error}"
    if probe.returncode == 0:
        return None
    if probe.returncode < 0:
        return f"the driver crashed (signal {-probe.returncode})"
    last_line = (probe.stderr.strip().splitlines() or ["the driver gave no reason"])[-1]
    return last_line.removeprefix("RuntimeError: ").removeprefix("ImportError: ").split(". ")[0]


def draw_something() -> None:
    """Draw a sphere; raise whatever the driver raises, or RuntimeError if the picture is blank."""
    model = mujoco.MjModel.from_xml_string(PROBE_MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = GlCamera(model, 0, (64, 64))
    if np.ptp(camera.take(data)) == 0:
        raise RuntimeError("the driver drew a blank picture")
    camera.close()


def _new_context(width: int, height: int) -> Any:
    if sys.platform == "linux" and not os.environ.get("MUJOCO_GL"):
        os.environ.setdefault("EGL_LOG_LEVEL", "fatal")  # Mesa complains about each driver that it tries
        try:
            from mujoco.egl import GLContext
        except AttributeError as error:  # what PyOpenGL makes of a missing library
            raise RuntimeError("libEGL is missing") from error
        return GLContext(width, height)
    if not hasattr(mujoco, "GLContext"):
        raise RuntimeError(f"MUJOCO_GL={os.environ.get('MUJOCO_GL')} turns OpenGL off")
    return mujoco.GLContext(width, height)


class GlCamera:
    """A camera of the model, drawn by MuJoCo's renderer."""

    def __init__(self, model: mujoco.MjModel, camera_id: int, size: tuple[int, int]) -> None:
        self._model = model
        self._rect = mujoco.MjrRect(0, 0, *size)
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._view.fixedcamid = camera_id
        self._option = mujoco.MjvOption()
        self._scene = mujoco.MjvScene(model, maxgeom=10_000)
        self._gl = _new_context(*size)
        self._gl.make_current()
        self._context = self._offscreen_context(size)

    def _offscreen_context(self, size: tuple[int, int]) -> mujoco.MjrContext:
        """Make a drawing context of this size, whatever size the model asks for."""
        wanted = self._model.vis.global_
        kept = wanted.offwidth, wanted.offheight
        wanted.offwidth, wanted.offheight = size
        context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        wanted.offwidth, wanted.offheight = kept
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        return context

    def take(self, data: mujoco.MjData) -> Image:
        """Draw the scene as it is now: (height, width, 3)."""
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._view, everything, self._scene)
        image = np.empty((self._rect.height, self._rect.width, 3), dtype=np.uint8)
        self._gl.make_current()
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(image, None, self._rect, self._context)
        return np.ascontiguousarray(image[::-1])  # OpenGL counts rows from the bottom

    def close(self) -> None:
        """Give the context back; the camera takes no pictures after that."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()
