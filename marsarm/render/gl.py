"""OpenGL without a display: a probe of this machine, and a camera.

The context is made here and not by MUJOCO_GL=egl. Without libEGL that setting breaks the import of mujoco,
and it has no effect after the import. If MUJOCO_GL is set, it takes precedence. The command line passes on
only values that turn OpenGL off.
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
PROBE = "from marsarm.render import gl; gl.draw_something()"
PROBE_MODEL = "<mujoco><worldbody><camera name='eye' pos='0 0 2'/><geom size='1'/></worldbody></mujoco>"


@functools.cache
def unavailable_reason() -> str | None:
    """Return why this machine cannot draw with OpenGL, or None if it can.

    A separate process tries to draw, once: a broken driver may print, block or crash.
    """
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        probe = subprocess.run(
            [sys.executable, "-P", "-c", PROBE],
            env=env,
            capture_output=True,
            text=True,
            timeout=PROBE_TIMEOUT_S,
            process_group=0,  # Ctrl-C is for the command, which then kills the probe
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
    """Draw a sphere to test the driver.

    Raises:
        RuntimeError: the picture is blank. The driver may raise other errors.
    """
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
        except AttributeError as error:  # PyOpenGL raises this for a missing library
            raise RuntimeError("libEGL is missing") from error
        return GLContext(width, height)
    if not hasattr(mujoco, "GLContext"):
        raise RuntimeError(f"MUJOCO_GL={os.environ.get('MUJOCO_GL')} turns OpenGL off")
    return mujoco.GLContext(width, height)


class GlCamera:
    """Camera of the model that uses MuJoCo's renderer."""

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
        """Make a drawing context of this size, independent of the size that the model sets."""
        visual = self._model.vis.global_
        model_size = visual.offwidth, visual.offheight
        visual.offwidth, visual.offheight = size
        context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        visual.offwidth, visual.offheight = model_size
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
        return context

    def take(self, data: mujoco.MjData) -> Image:
        """Draw the scene in its current state; shape (height, width, 3), 0 to 255."""
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._view, everything, self._scene)
        image = np.empty((self._rect.height, self._rect.width, 3), dtype=np.uint8)
        self._gl.make_current()
        mujoco.mjr_render(self._rect, self._scene, self._context)
        mujoco.mjr_readPixels(image, None, self._rect, self._context)
        return np.ascontiguousarray(image[::-1])  # OpenGL counts rows from the bottom

    def close(self) -> None:
        """Free the context; the camera cannot take pictures afterwards."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()
