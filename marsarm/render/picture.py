"""Pictures and movies of a scene, by ray casting in its model.

A picture that cannot be drawn never stops a run: the result states what is missing. A path that cannot be
written is refused before any work begins.
"""

import importlib.util
import os
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from marsarm.render.rays import Image, RayCamera
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_path, check_output

FRAMES_PER_S: Final = 16
NO_PILLOW: Final = "no {}: Pillow is missing; pip install pillow"


@dataclass(frozen=True, slots=True)
class PictureResult:
    """Picture or movie that was asked for."""

    path: Path | None
    """File; None if there is no picture."""
    hint: str | None = None
    """Reason why there is none, and what to install."""


def save_picture(
    model: mujoco.MjModel, data: mujoco.MjData, camera: str, path: Path, size: tuple[int, int] = (1280, 720)
) -> PictureResult:
    """Save the view of a camera after mj_forward as PNG; BadRequest if path, camera or size are wrong."""
    check_output(path, (".png",), "picture")
    opened = _open_camera(model, camera, size)
    if opened is None:
        return PictureResult(None, NO_PILLOW.format("picture"))
    import PIL.Image

    try:
        with _replace(path) as part:
            PIL.Image.fromarray(opened.take(data)).save(part, "PNG")
    except OSError as error:
        return _not_saved("picture", path, error)
    return PictureResult(path)


def save_movie(
    model: mujoco.MjModel,
    poses: Iterable[NDArray[np.float64]],
    camera: str,
    path: Path,
    size: tuple[int, int] = (640, 360),
) -> PictureResult:
    """Save a GIF with a frame for each pose (model.nq,), drawn after the run.

    BadRequest says that path, camera or size are wrong, or there is no pose.
    """
    check_output(path, (".gif",), "movie")
    opened = _open_camera(model, camera, size)
    if opened is None:
        return PictureResult(None, NO_PILLOW.format("movie"))
    data = mujoco.MjData(model)
    frames = []
    for qpos in poses:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)  # mj_camlight needs it for cameras that follow a body
        mujoco.mj_camlight(model, data)
        frames.append(opened.take(data))
    if not frames:
        raise BadRequest(f"movie {path}: there is no frame to write")
    try:
        _write_gif(frames, path)
    except OSError as error:
        return _not_saved("movie", path, error)
    return PictureResult(path)


def _not_saved(what: str, file: Path, error: OSError) -> PictureResult:
    """Report a file that could not be written; the run itself succeeded."""
    return PictureResult(None, f"no {what}: {file} cannot be written ({error.strerror or error})")


def _write_gif(frames: Sequence[Image], path: Path) -> None:
    """Write images as a GIF that repeats endlessly."""
    import PIL.Image

    images = [PIL.Image.fromarray(frame).quantize(128, dither=PIL.Image.Dither.NONE) for frame in frames]
    duration_ms = round(1000 / FRAMES_PER_S)
    with _replace(path) as part:
        images[0].save(part, "GIF", save_all=True, append_images=images[1:], duration=duration_ms, loop=0)


def _replace(path: Path) -> AbstractContextManager[Path]:
    """Give a temporary path for the file that a path names; a link stays a link."""
    return atomic_path(Path(os.path.realpath(path)))


def _open_camera(model: mujoco.MjModel, camera: str, size: tuple[int, int]) -> RayCamera | None:
    """Open a camera of the model; None without Pillow."""
    camera_id = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
    if camera_id < 0:
        names = ", ".join(model.camera(number).name for number in range(model.ncam)) or "none"
        raise BadRequest(f"picture: there is no camera {camera!r}; the model has: {names}")
    if min(size) < 1:
        raise BadRequest(f"picture: size {size[0]} x {size[1]} must be positive, in pixels")
    return RayCamera(model, camera_id, size) if importlib.util.find_spec("PIL") else None
