"""What is kept of a run: its log, a picture and a movie; the run goes on without any of them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from ground.report.picture import PictureError, PictureResult, check_path, save_movie, save_picture
from ground.request import BadRequest, check_apart
from ground.telemetry.errors import LogNotWritable
from ground.telemetry.record import Recorder
from sim.plant import Plant
from sim.record import CycleRecord
from sim.world import World, build

FRAME_EVERY_S = 3.0
PICTURE_SIZE = (1280, 720)
MOVIE_SHADOWS = 1024
"""Pixels across a shadow map: coarser than for a picture, and several times faster."""

Progress = Callable[[float, float, str], None]
"""Told what is done, what is to be done, and what it is."""
Pose = NDArray[np.float64]
"""Of everything that moves, as MuJoCo lists it."""


@dataclass(frozen=True, slots=True)
class Files:
    """Where what is kept goes; None for what is not."""

    log: Path | None = None
    picture: Path | None = None
    movie: Path | None = None


NO_FILES: Final = Files()


@dataclass(frozen=True, slots=True)
class Kept:
    """What became of it."""

    picture: PictureResult | None
    movie: PictureResult | None
    log_problem: str | None
    """From when on the log could not be written, and why; the run went on."""


def nothing_kept(files: Files) -> Kept:
    """Of a run that never began, its arm not initialised."""
    why = f"log {files.log}: not recorded (the arm was not initialised)"
    return Kept(None, None, None if files.log is None else why)


def check_files(files: Files, **others: Path | None) -> None:
    """Refuse files that cannot be written, or over each other or others that are read.

    Raises:
        BadRequest: they cannot; the log itself is opened before the run and says the rest.
    """
    check_apart({**others, "log": files.log, "picture": files.picture, "movie": files.movie})
    if files.log is not None and files.log.suffix.lower() != ".mcap":
        raise BadRequest(f"log {files.log}: its name must end in .mcap")
    try:
        if files.picture is not None:
            check_path(files.picture, ".png", "picture")
        if files.movie is not None:
            check_path(files.movie, ".gif", "movie")
    except PictureError as error:
        raise BadRequest(str(error)) from error


@dataclass(slots=True)
class Frames:
    """Poses of a run, one every so often, to be drawn after it."""

    poses: list[Pose] = field(default_factory=list)
    best: Pose | None = None
    """For the picture."""

    def note(self, plant: Plant, record: CycleRecord) -> bool:
        """Take the pose if it is time for one; whether it was."""
        due = record.tick % round(FRAME_EVERY_S * CYCLE_HZ) == 0
        if due:
            self.poses.append(plant.data.qpos.copy())
        return due

    def choose(self, plant: Plant) -> None:
        """Take the pose of now for the picture."""
        self.best = plant.data.qpos.copy()


class Log:
    """A recorder whose disk may fill up: the run goes on, and the report says what was not recorded."""

    def __init__(self, path: Path | None, recorder: Recorder | None):
        self._path = path
        self._recorder = recorder
        self.problem: str | None = None

    def write(self, record: CycleRecord) -> None:
        """Record a cycle if it can be."""
        if self._recorder is None or self.problem is not None:
            return
        try:
            self._recorder.write(record)
        except OSError as error:
            self._failed(error, f"from {record.tick / CYCLE_HZ:.2f} s on")

    def close(self) -> None:
        """End the file."""
        if self._recorder is None:
            return
        try:
            self._recorder.close()
        except OSError as error:
            if self.problem is None:
                self._failed(error, "at the end")

    def _failed(self, error: OSError, when: str) -> None:
        why = error.strerror or str(error)
        self.problem = f"log {self._path}: not recorded {when} ({why}); what was closed before can be read"


def open_log(path: Path | None, header: Mapping[str, str]) -> Log:
    """A log that begins with what the run is made of; one of nothing without a path.

    Raises:
        BadRequest: the file cannot be opened.
    """
    if path is None:
        return Log(None, None)
    try:
        return Log(path, Recorder(path, header))
    except LogNotWritable as error:
        raise BadRequest(str(error)) from error


def doing(record: CycleRecord) -> str:
    """What the arm is doing, for a progress bar."""
    return record.outputs.joint.mode.name.lower().replace("_", " ")


def keep(files: Files, world: World, frames: Frames, last: Pose, log: Log, progress: Progress) -> Kept:
    """Draw the picture and the movie of a run, from the model with everything that only looks."""
    if files.picture is None and files.movie is None:
        return Kept(None, None, log.problem)
    model = build(world, for_pictures=True).compile()
    picture = movie = None
    if files.picture is not None:
        data = mujoco.MjData(model)
        data.qpos[:] = last if frames.best is None else frames.best
        mujoco.mj_forward(model, data)
        camera = "workspace" if world.surface is None else "target"
        picture = save_picture(model, data, camera, files.picture, PICTURE_SIZE)
    if files.movie is not None:

        def drawn() -> Iterator[Pose]:
            for k, pose in enumerate(frames.poses):
                progress(k, len(frames.poses), "drawing")
                yield pose

        model.vis.quality.shadowsize = MOVIE_SHADOWS
        movie = save_movie(model, drawn(), "overview", files.movie)
    return Kept(picture, movie, log.problem)
