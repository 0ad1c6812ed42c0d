"""What is kept of a run: its log, a picture and a movie; the run goes on without any of them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ, Config
from fsw.dictionary.enums import HARDSTOP_ORDER
from fsw.dictionary.evrs import Evr, Severity
from ground.common.files import BadOutput, check_output
from ground.common.progress import Progress
from ground.common.requests import BadRequest, check_distinct_files
from ground.render.picture import PictureError, PictureResult, check_picture_path, save_movie, save_picture
from ground.render.rover_scene import tilt_rover
from ground.telemetry.errors import LogNotWritable
from ground.telemetry.recorder import Recorder
from sim.arms import BuiltArm
from sim.initialisation import InitialisationResult, initialise_joints
from sim.plant import Plant
from sim.record import CycleRecord
from sim.world import World, build


def initialise(arm: BuiltArm, seed: int, progress: Progress) -> list[InitialisationResult]:
    """Every joint at its hardstop, one after the other; the last one of the list may have failed."""
    stops: list[InitialisationResult] = []
    for run in initialise_joints(arm, seed=seed):
        if run.failure is not None:
            raise run.failure
        stops.append(run)
        progress(len(stops), len(HARDSTOP_ORDER), "initialising")
    return stops


FRAME_PERIOD_S = 3.0
PICTURE_SIZE = (1280, 720)
MOVIE_SHADOWS = 1024
"""Pixels across a shadow map: coarser than for a picture, and several times faster."""

Qpos = NDArray[np.float64]
"""Of everything that moves, as MuJoCo lists it."""


WhenDiskFull = Literal["go-on", "stop"]
"""What a run does whose log can no longer be written."""


@dataclass(frozen=True, slots=True)
class LogNotWritten(Evr):
    """The log of the run could not be written on; said by the ground, not by flight software."""

    severity = Severity.WARNING_HI
    text = "log {e.path}: not recorded from {e.from_s:.2f} s on ({e.why}); what was closed before can be read"
    path: str
    from_s: float
    why: str


@dataclass(frozen=True, slots=True)
class RunFiles:
    """Where what is kept goes; None for what is not."""

    log: Path | None = None
    picture: Path | None = None
    movie: Path | None = None
    when_disk_full: WhenDiskFull = "go-on"


NO_FILES: Final = RunFiles()


@dataclass(frozen=True, slots=True)
class Artifacts:
    """What became of it."""

    picture: PictureResult | None
    movie: PictureResult | None
    log_problem: str | None
    """Why there is no whole log."""
    events: tuple[tuple[float, Evr], ...] = ()
    """Time [s] and event of what the ground has to say of it."""


def no_artifacts(files: RunFiles) -> Artifacts:
    """Of a run that never began, its arm not initialised."""
    why = f"log {files.log}: not recorded (the arm was not initialised)"
    return Artifacts(None, None, None if files.log is None else why)


def check_run_files(files: RunFiles, **others: Path | None) -> None:
    """Refuse files that cannot be written, or over each other or others that are read.

    Raises:
        BadRequest: they cannot; the log itself is opened before the run and says the rest.
    """
    check_distinct_files({**others, "log": files.log, "picture": files.picture, "movie": files.movie})
    try:
        if files.log is not None:
            check_output(files.log, (".mcap",), "log")
        if files.picture is not None:
            check_picture_path(files.picture, ".png", "picture")
        if files.movie is not None:
            check_picture_path(files.movie, ".gif", "movie")
    except (PictureError, BadOutput) as error:
        raise BadRequest(str(error)) from error


@dataclass(slots=True)
class Frames:
    """Poses of a run, one every so often, to be drawn after it."""

    poses: list[Qpos] = field(default_factory=list)
    best: Qpos | None = None
    """For the picture."""

    def note(self, plant: Plant, record: CycleRecord) -> bool:
        """Take the pose if it is time for one; whether it was."""
        due = record.tick % round(FRAME_PERIOD_S * CYCLE_HZ) == 0
        if due:
            self.poses.append(plant.data.qpos.copy())
        return due

    def choose(self, plant: Plant) -> None:
        """Take the pose of now for the picture."""
        self.best = plant.data.qpos.copy()


class RunLog:
    """A recorder whose disk may fill up: an event says what was not recorded."""

    def __init__(self, path: Path | None, recorder: Recorder | None):
        self._path = path
        self._recorder = recorder
        self._last_s = 0.0
        self.events: tuple[tuple[float, LogNotWritten], ...] = ()
        """Time [s] and event: one, if the log could not be written on."""

    def write(self, record: CycleRecord) -> None:
        """Record a cycle if it can be."""
        if self._recorder is None or self.events:
            return
        self._last_s = record.tick / CYCLE_HZ
        try:
            self._recorder.write(record)
        except OSError as error:
            self._failed(self._recorder, error)

    def close(self) -> None:
        """End the file."""
        if self._recorder is None:
            return
        try:
            self._recorder.close()
        except OSError as error:
            if not self.events:
                self._failed(self._recorder, error)

    def _failed(self, recorder: Recorder, error: OSError) -> None:
        from_s = recorder.written_cycles / CYCLE_HZ
        event = LogNotWritten(str(self._path), from_s, error.strerror or str(error))
        self.events = ((self._last_s, event),)


def open_log(path: Path | None, header: Mapping[str, str], config: Config) -> RunLog:
    """A log that begins with what the run is made of; one of nothing without a path.

    Raises:
        BadRequest: the file cannot be opened.
    """
    if path is None:
        return RunLog(None, None)
    try:
        return RunLog(path, Recorder(path, header, config))
    except LogNotWritable as error:
        raise BadRequest(str(error)) from error


class StoppableRun(Protocol):
    """A run that can be stopped before its end."""

    def __iter__(self) -> Iterator[CycleRecord]:
        """Every cycle, as it happens."""

    def stopping(self) -> Iterator[CycleRecord]:
        """Every cycle of a stop, in place of those that were still to come."""


def record_cycles(run: StoppableRun, log: RunLog, when_disk_full: WhenDiskFull) -> Iterator[CycleRecord]:
    """Every cycle, recorded as far as it can be; a stop where it can not, if so asked."""
    for record in run:
        log.write(record)
        yield record
        if log.events and when_disk_full == "stop":
            yield from run.stopping()
            return


def describe_activity(record: CycleRecord) -> str:
    """What the arm is doing, for a progress bar."""
    return record.outputs.joint.mode.name.lower().replace("_", " ")


def save_artifacts(
    files: RunFiles, world: World, frames: Frames, last: Qpos, log: RunLog, progress: Progress
) -> Artifacts:
    """Draw the picture and the movie of a run, from the model with everything that only looks."""
    problem = next((event.message for _, event in log.events), None)
    if files.picture is None and files.movie is None:
        return Artifacts(None, None, problem, log.events)
    spec = build(world, for_pictures=True)
    tilt_rover(spec)
    model = spec.compile()
    picture = movie = None
    if files.picture is not None:
        data = mujoco.MjData(model)
        data.qpos[:] = last if frames.best is None else frames.best
        mujoco.mj_forward(model, data)
        camera = "turret" if world.surface is None else "target"
        picture = save_picture(model, data, camera, files.picture, PICTURE_SIZE)
    if files.movie is not None:

        def drawn() -> Iterator[Qpos]:
            for k, pose in enumerate(frames.poses):
                progress(k, len(frames.poses), "drawing")
                yield pose

        model.vis.quality.shadowsize = MOVIE_SHADOWS
        movie = save_movie(model, drawn(), "overview", files.movie)
    return Artifacts(picture, movie, problem, log.events)
