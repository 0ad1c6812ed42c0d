"""Execution of a run in the closed loop: find the hardstops, record every cycle, draw the picture and movie.

A run continues if its log, picture or movie cannot be written.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, Generic, Protocol, Self, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ, Config, digest
from fsw.dictionary.enums import HARDSTOP_ORDER
from fsw.dictionary.evrs import Evr, Severity
from marsarm.render.picture import PictureResult, check_movie_path, save_movie, save_picture
from marsarm.render.rover_scene import tilt_rover
from marsarm.runs.request import RunFiles, WhenDiskFull
from marsarm.telemetry.errors import LogNotWritable
from marsarm.telemetry.recorder import Recorder
from marsarm.telemetry.robot_description import draw_scene
from sim.arm_model.load import ArmModel
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.initialisation import InitialisationResult, initialise_joints
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.world import World, build
from simgap.common.errors import BadRequest
from simgap.common.interruption import describe_interruption
from simgap.common.progress import Progress, part_of

if TYPE_CHECKING:
    from marsarm.view.server import LiveView

FRAME_CYCLES: Final = 3 * CYCLE_HZ
"""Cycles between two frames of a movie, and between two reports of the progress."""
INITIALISATION_SHARE: Final = 0.3
"""Share of the initialisation in the wall time of a placement or scenario, for the progress: 13 s of 45 s."""
PICTURE_SIZE = (1280, 720)
MOVIE_SHADOWS = 1024
"""Side of a shadow map in pixels: coarser than for a picture, and several times faster."""

Qpos = NDArray[np.float64]
"""Positions of the model as in MuJoCo's qpos, shape (nq,), in metres and radians."""


@dataclass(frozen=True, slots=True)
class LogNotWritten(Evr):
    """Event of the ground, not of flight software: the log of the run could not be continued."""

    severity = Severity.WARNING_HI
    text = "log {e.path}: not recorded from {e.from_s:.2f} s on ({e.why}); what was closed before can be read"
    path: str
    from_s: float
    why: str


@dataclass(frozen=True, slots=True)
class Artifacts:
    """Files that a run wrote."""

    picture: PictureResult | None
    movie: PictureResult | None
    log_problem: str | None
    """Reason why the log is not complete."""
    events: tuple[tuple[float, Evr], ...] = ()
    """Time [s] and event of each event of the ground."""


def initialise(arm: BuiltArm, seed: int, progress: Progress) -> list[InitialisationResult]:
    """Find the hardstop of every joint in turn, until one fails; return the result of each.

    Raises:
        Exception: the one that ended flight software.
    """
    stops: list[InitialisationResult] = []
    for run in initialise_joints(arm, seed=seed):
        if run.failure is not None:
            raise run.failure
        stops.append(run)
        progress(len(stops), len(HARDSTOP_ORDER), "initialising")
    return stops


@dataclass(slots=True)
class DrawnPoses:
    """Poses of a run, which are drawn after it."""

    poses: list[Qpos] = field(default_factory=list)
    """Poses for the movie, at regular intervals; none without a movie."""
    best: Qpos | None = None
    """Pose for the picture."""


class RunLog:
    """Recorder that survives a full disk: an event states from when on nothing was recorded."""

    def __init__(self, path: Path | None, recorder: Recorder | None):
        self._path = path
        self._recorder = recorder
        self._last_s = 0.0
        self.events: tuple[tuple[float, LogNotWritten], ...] = ()
        """Time [s] and event; empty if the log is complete, else one."""

    def write(self, record: CycleRecord) -> None:
        """Record a cycle, unless recording has failed before."""
        if self._recorder is None or self.events:
            return
        self._last_s = record.tick / CYCLE_HZ
        try:
            self._recorder.write(record)
        except OSError as error:
            self._note_failure(self._recorder, error)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close("" if error is None else describe_interruption(error))
        if error is not None and self._recorder is not None:
            error.add_note(f"log {self._path} ends at {self._last_s:.2f} s and says so")

    def close(self, interrupted_by: str = "") -> None:
        """Complete and close the file; it says what interrupted the run, unless this is empty."""
        if self._recorder is None:
            return
        try:
            self._recorder.close(interrupted_by)
        except OSError as error:
            if not self.events:
                self._note_failure(self._recorder, error)

    def _note_failure(self, recorder: Recorder, error: OSError) -> None:
        from_s = recorder.written_cycles / CYCLE_HZ
        event = LogNotWritten(str(self._path), from_s, error.strerror or str(error))
        self.events = ((self._last_s, event),)


def open_log(
    path: Path | None, header: Mapping[str, str], config: Config, world: World, arm: ArmModel | None
) -> RunLog:
    """Open the log of a run, one that records nothing if there is no path.

    Raises:
        BadRequest: the file cannot be opened.
    """
    if path is None:
        return RunLog(None, None)
    try:
        return RunLog(path, Recorder(path, header, config, scene=draw_scene(world, arm)))
    except LogNotWritable as error:
        raise BadRequest(str(error)) from error


class RunResult(Protocol):
    """Result of a run."""

    @property
    def duration_s(self) -> float:
        """Duration on Mars."""


Result = TypeVar("Result", bound=RunResult)
Result_co = TypeVar("Result_co", bound=RunResult, covariant=True)


class StoppableRun(Protocol[Result_co]):
    """Run that can be stopped before its end."""

    def __iter__(self) -> Iterator[CycleRecord]:
        """Run cycle by cycle."""

    def stopping(self) -> Iterator[CycleRecord]:
        """Stop the arm cycle by cycle, instead of the remaining cycles."""

    def result(self) -> Result_co:
        """Return the result; valid after the last cycle."""


def record_cycles(
    run: StoppableRun[Result], log: RunLog, when_disk_full: WhenDiskFull
) -> Iterator[CycleRecord]:
    """Run and record cycle by cycle; if the log can no longer be written, go on or stop the arm."""
    for record in run:
        log.write(record)
        yield record
        if log.events and when_disk_full == "stop":
            yield from run.stopping()
            return


def describe_activity(record: CycleRecord) -> str:
    """Return the current mode of the arm in words, for a progress bar."""
    return record.outputs.joint.mode.name.lower().replace("_", " ")


def save_artifacts(
    files: RunFiles,
    world: World,
    drawn: DrawnPoses,
    last: Qpos,
    log: RunLog,
    progress: Progress,
    arm: ArmModel | None = None,
) -> Artifacts:
    """Draw the picture and the movie of a run, and collect its artifacts.

    Args:
        world: World of the run; its scene is drawn with all visual details.
        last: Last pose, drawn if no pose was chosen, shape (nq,), in metres and radians.
        log: Log of the run, closed.
        arm: Drawing of the arm; None for the default one.
    """
    problem = next((event.message for _, event in log.events), None)
    if files.picture is None and files.movie is None:
        return Artifacts(None, None, problem, log.events)
    spec = build(world, arm, for_pictures=True)
    tilt_rover(spec)
    model = spec.compile()
    picture = movie = None
    if files.picture is not None:
        data = mujoco.MjData(model)
        data.qpos[:] = last if drawn.best is None else drawn.best
        mujoco.mj_forward(model, data)
        camera = "turret" if world.surface is None else "target"
        picture = save_picture(model, data, camera, files.picture, PICTURE_SIZE)
    if files.movie is not None:

        def iter_poses() -> Iterator[Qpos]:
            for k, pose in enumerate(drawn.poses):
                progress(k, len(drawn.poses), "drawing")
                yield pose

        model.vis.quality.shadowsize = MOVIE_SHADOWS
        movie = save_movie(model, iter_poses(), "overview", files.movie)
    return Artifacts(picture, movie, problem, log.events)


@dataclass(frozen=True, slots=True)
class Execution(Generic[Result]):
    """Run that was carried out."""

    result: Result
    params_sha256: str
    realtime_factor: float
    """Duration on Mars over wall time; 0 for a run that did not begin."""
    artifacts: Artifacts
    view: "LiveView | None" = None
    """Viewer that shows the run, if one was asked for."""


def check_files(files: RunFiles) -> None:
    """Refuse a movie that this machine cannot write by a PictureError, before anything moves."""
    if files.movie is not None:
        check_movie_path(files.movie)


@contextmanager
def open_view(
    is_wanted: bool, title: str, world: World, arm: BuiltArm, effects: Sequence[Effect]
) -> Iterator["LiveView | None"]:
    """Open a viewer for the runs of the block; give None if none is wanted.

    It is stopped if the block fails, or no run begins in it. Else it stays open, to play the runs again.

    Args:
        effects: Effects beyond those of the arm.

    Raises:
        BadRequest: the viewer cannot be opened.
    """
    if not is_wanted:
        yield None
        return
    from marsarm.view.server import LiveView  # a run without a viewer does not wait for it

    with ExitStack() as stack:
        view = stack.enter_context(LiveView(title, world, arm, effects))
        yield view
        if view.has_begun:
            stack.pop_all()


def execution_not_begun(result: Result, arm: BuiltArm, files: RunFiles) -> Execution[Result]:
    """Return the record of a run that did not begin because its arm was not initialised."""
    reason = f"log {files.log}: not recorded (the arm was not initialised)"
    artifacts = Artifacts(None, None, None if files.log is None else reason)
    return Execution(result, digest(arm.params), 0.0, artifacts)


def execute(
    run: StoppableRun[Result],
    loop: ClosedLoop,
    header: Mapping[str, str],
    files: RunFiles,
    world: World,
    progress: Progress,
    progress_at: Callable[[CycleRecord], tuple[float, float]],
    is_for_picture: Callable[[CycleRecord], bool],
    arm: ArmModel,
    view: "LiveView | None" = None,
) -> Execution[Result]:
    """Carry out a run: record every cycle, then draw the picture and the movie.

    Args:
        progress_at: Function that returns the amount done at a cycle, and the total amount.
        is_for_picture: Function that returns whether the picture may show a cycle; it shows the last one.
        arm: Drawing of the arm, for log, picture and movie.

    Raises:
        BadRequest: the log cannot be opened; nothing moved.
    """
    share = 1.0 if files.movie is None else 0.5
    running, drawing = part_of(progress, 0.0, share), part_of(progress, share, 1.0)
    drawn = DrawnPoses()
    started = time.perf_counter()
    with open_log(files.log, header, loop.config, world, arm) as log:
        for record in record_cycles(run, log, files.when_disk_full):
            if record.tick % FRAME_CYCLES == 0:
                running(*progress_at(record), describe_activity(record))
                if files.movie is not None:
                    drawn.poses.append(loop.plant.data.qpos.copy())
            if view is not None:
                view.watch(record)
            if is_for_picture(record):
                drawn.best = loop.plant.data.qpos.copy()
    wall_s = time.perf_counter() - started
    if loop.failure is not None:
        raise loop.failure
    result = run.result()
    artifacts = save_artifacts(files, world, drawn, loop.plant.data.qpos, log, drawing, arm)
    return Execution(result, loop.config.params_sha256, result.duration_s / wall_s, artifacts, view)
