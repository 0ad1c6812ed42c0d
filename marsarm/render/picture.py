"""Pictures and movies of a scene, by MuJoCo's renderer or, without OpenGL, by ray casting in the same model.

A picture that cannot be drawn never stops a run: the result states what is missing. A path that cannot be
written is refused before any work begins.

The context of OpenGL is made here and not by MUJOCO_GL=egl. Without libEGL that setting breaks the import of
mujoco, and it has no effect after the import. If MUJOCO_GL is set, it takes precedence. The command line
passes on only values that turn OpenGL off.
"""

import functools
import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any, Final, Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from marsarm.render.rays import RayCamera
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_path, check_output
from simgap.common.interruption import block_signals

Image = NDArray[np.uint8]
Renderer = Literal["opengl", "rays", "none"]

FRAMES_PER_S: Final = 16
FINER: Final = 2
"""Factor of the pixels along a side of a picture that OpenGL draws: else the edges of shadows are saws.

So many pixels need no further samples of each, which take a third of the time to draw.
"""
APT: Final = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"


@dataclass(frozen=True, slots=True)
class PictureResult:
    """Picture or movie: its file, and the renderer that drew it."""

    path: Path | None
    """None if there is no picture."""
    renderer: Renderer
    hint: str | None = None
    """Reason why there is no picture, or only one by ray casting, and what to install."""


class Camera(Protocol):
    """Camera of a scene."""

    def take(self, data: mujoco.MjData) -> Image:
        """Draw the scene in its current state; shape (height, width, 3), 0 to 255."""

    def close(self) -> None:
        """Free the resources of the camera."""


def save_picture(
    model: mujoco.MjModel, data: mujoco.MjData, camera: str, path: Path, size: tuple[int, int] = (1280, 720)
) -> PictureResult:
    """Save the view of a camera after mj_forward as PNG; BadRequest if path, camera or size are wrong."""
    check_output(path, (".png",), "picture")
    opened, result = _open_camera(model, camera, path, size, FINER)
    if opened is None:
        return result
    try:
        image = opened.take(data)
    finally:
        opened.close()
    import PIL.Image

    try:
        with _replace(path) as part:
            drawn = PIL.Image.fromarray(image)
            drawn.reduce(drawn.width // size[0]).save(part, "PNG")
    except OSError as error:
        return _not_saved("picture", path, error)
    return result


def save_movie(
    model: mujoco.MjModel,
    poses: Iterable[NDArray[np.float64]],
    camera: str,
    path: Path,
    size: tuple[int, int] = (640, 360),
) -> PictureResult:
    """Save an MP4 or GIF, by its suffix, with a frame for each pose (model.nq,), drawn after the run.

    The size is in pixels, even for an MP4. BadRequest says that path, camera or size are wrong, PyAV is
    missing for an MP4, or there is no pose.
    """
    check_movie_path(path)
    opened, result = _open_camera(model, camera, path, size)
    if opened is None:
        return result
    data = mujoco.MjData(model)
    frames = []
    try:
        for qpos in poses:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)  # mj_camlight needs it for cameras that follow a body
            mujoco.mj_camlight(model, data)
            frames.append(opened.take(data))
    finally:
        opened.close()
    if not frames:
        raise BadRequest(f"movie {path}: there is no frame to write")
    try:
        (_write_gif if path.suffix.lower() == ".gif" else _write_mp4)(frames, path)
    except OSError as error:
        return _not_saved("movie", path, error)
    return result


def _not_saved(what: str, file: Path, error: OSError) -> PictureResult:
    """Report a file that could not be written; the run itself succeeded."""
    return PictureResult(None, "none", f"no {what}: {file} cannot be written ({error.strerror or error})")


def _write_gif(frames: Sequence[Image], path: Path) -> None:
    """Write images as a GIF that repeats endlessly."""
    import PIL.Image

    images = [PIL.Image.fromarray(frame).quantize(128, dither=PIL.Image.Dither.NONE) for frame in frames]
    duration_ms = round(1000 / FRAMES_PER_S)
    with _replace(path) as part:
        images[0].save(part, "GIF", save_all=True, append_images=images[1:], duration=duration_ms, loop=0)


def _write_mp4(frames: Sequence[Image], path: Path) -> None:
    """Write images of even sizes as an MP4 with H.264, which every browser plays."""
    import av

    with (
        _replace(path) as part,
        av.open(str(part), "w", format="mp4", options={"movflags": "faststart"}) as container,
    ):
        stream = container.add_stream("libx264", rate=FRAMES_PER_S, options={"crf": "20"})
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for image in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())


def _replace(path: Path) -> AbstractContextManager[Path]:
    """Give a temporary path for the file that a path names; a link stays a link."""
    return atomic_path(Path(os.path.realpath(path)))


def check_movie_path(path: Path) -> None:
    """Refuse, by BadRequest, a path at which no movie can be written; an MP4 needs PyAV, a GIF does not."""
    check_output(path, (".gif", ".mp4"), "movie")
    if path.suffix.lower() == ".mp4" and importlib.util.find_spec("av") is None:
        raise BadRequest(f"movie {path}: PyAV is missing; pip install 'marsarm[movie]', or name a .gif")


def _open_camera(
    model: mujoco.MjModel, camera: str, file: Path, size: tuple[int, int], finer: int = 1
) -> tuple[Camera | None, PictureResult]:
    """Open a camera of the model with the best renderer of this machine, and describe its picture.

    OpenGL draws `finer` times the pixels along each side; the ray camera has several rays at edges.
    """
    camera_id = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
    if camera_id < 0:
        names = ", ".join(model.camera(number).name for number in range(model.ncam)) or "none"
        raise BadRequest(f"picture: there is no camera {camera!r}; the model has: {names}")
    if min(size) < 1:
        raise BadRequest(f"picture: size {size[0]} x {size[1]} must be positive, in pixels")
    if importlib.util.find_spec("PIL") is None:
        return None, PictureResult(None, "none", "no picture: Pillow is missing; pip install pillow")
    reason = unavailable_reason()
    if reason is None:
        finer_size = (finer * size[0], finer * size[1])
        samples = model.vis.quality.offsamples if finer == 1 else 0
        return GlCamera(model, camera_id, finer_size, samples), PictureResult(file, "opengl")
    hint = f"drawn without OpenGL ({reason}); for the real picture: {APT}"
    return RayCamera(model, camera_id, size), PictureResult(file, "rays", hint)


def probe_in_background() -> None:
    """Begin to find out whether OpenGL can draw here; who asks before that is known, asks again."""
    with block_signals():  # the main thread receives them
        Thread(target=unavailable_reason, daemon=True).start()


PROBE_TIMEOUT_S = 30.0
PROBE = "from marsarm.render.picture import draw_something; draw_something()"
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
            process_group=0,  # Ctrl-C is for the command
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
    """Draw a sphere to test the driver; RuntimeError, or an error of the driver, if that fails."""
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

    def __init__(
        self, model: mujoco.MjModel, camera_id: int, size: tuple[int, int], samples: int = 0
    ) -> None:
        self._model = model
        self._rect = mujoco.MjrRect(0, 0, *size)
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._view.fixedcamid = camera_id
        self._option = mujoco.MjvOption()
        self._scene = mujoco.MjvScene(model, maxgeom=10_000)
        self._gl = _new_context(*size)
        self._gl.make_current()
        self._context = self._offscreen_context(size, samples)

    def _offscreen_context(self, size: tuple[int, int], samples: int) -> mujoco.MjrContext:
        """Make a drawing context of this size and samples a pixel, independent of what the model sets."""
        visual, quality = self._model.vis.global_, self._model.vis.quality
        model_size, model_samples = (visual.offwidth, visual.offheight), quality.offsamples
        (visual.offwidth, visual.offheight), quality.offsamples = size, samples
        context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        (visual.offwidth, visual.offheight), quality.offsamples = model_size, model_samples
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
