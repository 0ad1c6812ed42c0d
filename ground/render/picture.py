"""Pictures and movies of a scene, by MuJoCo's renderer or, without OpenGL, by rays cast into the same model.

A picture that cannot be drawn never stops a run: the result says what is missing. A path that cannot be
written is bad input; `check_picture_path` finds it before any work is done.
"""

import importlib.util
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from ground.common.files import BadOutput, check_output
from ground.render import gl
from ground.render.rays import RayCamera

Image = NDArray[np.uint8]
Renderer = Literal["opengl", "rays", "none"]

APT = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"


class PictureError(ValueError):
    """A picture was asked for that cannot be taken: a path, a camera or a size is wrong."""


@dataclass(frozen=True, slots=True)
class PictureResult:
    """Where the picture is, what drew it, and how to get a better one; path is None if there is none."""

    path: Path | None
    renderer: Renderer
    hint: str | None = None


class Camera(Protocol):
    """Something that takes pictures of a scene."""

    def take(self, data: mujoco.MjData) -> Image:
        """Draw the scene as it is now: (height, width, 3)."""

    def close(self) -> None:
        """Give back what the camera holds."""


def save_picture(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    camera: str,
    path: str | os.PathLike[str],
    size: tuple[int, int] = (1280, 720),
) -> PictureResult:
    """Save what a camera of the model sees as a PNG file.

    `data` must be current (after mj_forward or mj_step); `size` is width and height in pixels.

    Raises:
        PictureError: the path cannot be written, there is no such camera, or the size is not positive.
    """
    file = check_picture_path(path, ".png", "picture")
    eye, shown = _open(model, camera, file, size)
    if eye is None:
        return shown
    try:
        image = eye.take(data)
    finally:
        eye.close()
    import PIL.Image

    try:
        PIL.Image.fromarray(image).save(file)
    except OSError as error:
        return _not_saved("picture", file, error)
    return shown


def save_movie(
    model: mujoco.MjModel,
    poses: Iterable[NDArray[np.float64]],
    camera: str,
    path: str | os.PathLike[str],
    size: tuple[int, int] = (640, 360),
    frames_per_s: float = 16.0,
) -> PictureResult:
    """Save a GIF with one frame for each pose, each an array of qpos (model.nq,).

    Poses and not pictures, so that a run collects a few numbers a frame and the drawing comes after it.

    Raises:
        PictureError: the path cannot be written, there is no such camera, or the size is not positive.
    """
    file = check_picture_path(path, ".gif", "movie")
    eye, shown = _open(model, camera, file, size)
    if eye is None:
        return shown
    data = mujoco.MjData(model)
    frames = []
    try:
        for qpos in poses:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)  # what mj_camlight needs for cameras that follow a body
            mujoco.mj_camlight(model, data)
            frames.append(eye.take(data))
    finally:
        eye.close()
    try:
        write_gif(frames, file, frames_per_s)
    except OSError as error:
        return _not_saved("movie", file, error)
    return shown


def _not_saved(what: str, file: Path, error: OSError) -> PictureResult:
    """What was run is told all the same."""
    return PictureResult(None, "none", f"no {what}: {file} cannot be written ({error.strerror or error})")


def write_gif(frames: Iterable[Image], path: str | os.PathLike[str], frames_per_s: float = 16.0) -> None:
    """Write images (height, width, 3) as a GIF that repeats for ever.

    Raises:
        PictureError: the path cannot be written or there is no frame.
    """
    import PIL.Image

    file = check_picture_path(path, ".gif", "movie")
    images = [PIL.Image.fromarray(frame).quantize(128, dither=PIL.Image.Dither.NONE) for frame in frames]
    if not images:
        raise PictureError(f"movie {file}: there is no frame to write")
    duration_ms = round(1000 / frames_per_s)
    images[0].save(file, save_all=True, append_images=images[1:], duration=duration_ms, loop=0)


def check_picture_path(path: str | os.PathLike[str], suffix: str, what: Literal["picture", "movie"]) -> Path:
    """Give the path back if a picture or movie can be written there.

    Raises:
        PictureError: wrong suffix, no such folder, a name that cannot be, or no right to write.
    """
    try:
        return check_output(path, (suffix,), what)
    except BadOutput as error:
        raise PictureError(str(error)) from error


def _open(
    model: mujoco.MjModel, camera: str, file: Path, size: tuple[int, int]
) -> tuple[Camera | None, PictureResult]:
    """Open a camera of the model, the best that this machine has, and say what its picture will be."""
    camera_id = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
    if camera_id < 0:
        names = ", ".join(model.camera(number).name for number in range(model.ncam)) or "none"
        raise PictureError(f"picture: there is no camera {camera!r}; the model has: {names}")
    if min(size) < 1:
        raise PictureError(f"picture: size {size[0]} x {size[1]} must be positive, in pixels")
    if importlib.util.find_spec("PIL") is None:
        return None, PictureResult(None, "none", "no picture: Pillow is missing; pip install pillow")
    reason = gl.unavailable_reason()
    if reason is None:
        return gl.GlCamera(model, camera_id, size), PictureResult(file, "opengl")
    hint = f"drawn without OpenGL ({reason}); for the real picture: {APT}"
    return RayCamera(model, camera_id, size), PictureResult(file, "rays", hint)
