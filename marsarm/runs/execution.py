"""Execution of a run in the closed loop: find the hardstops, record every cycle, draw the picture.

A run continues if its log or picture cannot be written.
"""

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Final, Generic, Protocol, Self, TypeVar

import mujoco

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import HARDSTOP_ORDER
from fsw.dictionary.evrs import Evr, Severity
from fsw.dictionary.params import Params, digest
from fsw.kinematics.transforms import Array
from marsarm.render.rays import RayCamera
from marsarm.render.rover_scene import tilt_rover
from marsarm.runs.request import RunFiles
from marsarm.telemetry.format import SAMPLE_CYCLES, LogNotWritable
from marsarm.telemetry.recorder import Recorder
from sim.arm_model.load import ArmModel
from sim.arms import BuiltArm
from sim.initialisation import InitialisationResult, initialise_joints
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.setting import World
from sim.world import build
from simgap.common.errors import BadOutput, BadRequest, UserError
from simgap.common.files import atomic_path
from simgap.common.interruption import describe_interruption
from simgap.common.progress import Progress, part_of

FRAME_CYCLES: Final = 3 * CYCLE_HZ
"""Cycles between two reports of the progress."""
INITIALISATION_SHARE: Final = 0.45
"""Share of the initialisation in the time of a placement or scenario, for the progress: 5.5 s of 13 s."""
DRAWING_SHARE: Final = 0.1
"""Share of picture and page: 1.3 s of 13 s."""
PICTURE_SIZE: Final = (1280, 720)


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

    picture: Path | None = None
    picture_problem: str | None = None
    """Reason why there is no picture."""
    page: Path | None = None
    page_problem: str | None = None
    """Reason why there is no page."""
    replaced: frozenset[Path] = frozenset()
    """Files that were there before."""
    log_problem: str | None = None
    """Reason why the log is not complete."""
    events: tuple[tuple[float, Evr], ...] = ()
    """Time [s] and event of each event of the ground."""


def initialise(arm: BuiltArm, seed: int, progress: Progress) -> InitialisationResult:
    """Find the hardstop of every joint until one fails; return the last result, or raise what ended a run."""
    initialising = part_of(progress, 0.0, INITIALISATION_SHARE)
    initialising(0, len(HARDSTOP_ORDER), "initialising")
    for number, last in enumerate(initialise_joints(arm, seed=seed), 1):
        if last.failure is not None:
            raise last.failure
        initialising(number, len(HARDSTOP_ORDER), "initialising")
    return last


class RunLog:
    """Recorder that survives a full disk: an event states from when on nothing was recorded.

    A context manager. Without a path it records nothing.
    """

    def __init__(self, path: Path | None, header: Mapping[str, str], params: Params, is_kept: bool) -> None:
        """Open the log, which is for the page alone if it is not kept; BadRequest if it cannot be opened."""
        self._path, self._is_kept, self._last_s = path, is_kept, 0.0
        self._recorder: Recorder | None = None
        self.events: tuple[tuple[float, LogNotWritten], ...] = ()
        """Time [s] and event; empty if the log is complete, else one."""
        if path is not None:
            try:
                self._recorder = Recorder(path, header, params)
            except LogNotWritable as error:
                raise BadRequest(str(error)) from error

    def write(self, record: CycleRecord) -> None:
        """Record a cycle, unless recording has failed before."""
        if self._recorder is not None and not self.events:
            self._last_s = record.tick / CYCLE_HZ
            with self._note_failure(self._recorder):
                self._recorder.write(record)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the file; it says what interrupted the run."""
        if self._recorder is None:
            return
        with self._note_failure(self._recorder):
            self._recorder.close("" if error is None else describe_interruption(error))
        if error is not None and self._is_kept:
            error.add_note(f"log {self._path} ends at {self._last_s:.2f} s and says so")

    @contextmanager
    def _note_failure(self, recorder: Recorder) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            from_s = recorder.written_cycles / CYCLE_HZ
            event = LogNotWritten(str(self._path), from_s, error.strerror or str(error))
            self.events = self.events or ((self._last_s, event),)


class RunResult(Protocol):
    """Result of a run."""

    @property
    def duration_s(self) -> float:
        """Duration on Mars."""


Result = TypeVar("Result", bound=RunResult)
Result_co = TypeVar("Result_co", bound=RunResult, covariant=True)


class Run(Protocol[Result_co]):
    """Run in the closed loop."""

    def __iter__(self) -> Iterator[CycleRecord]:
        """Run cycle by cycle."""

    def result(self) -> Result_co:
        """Return the result; valid after the last cycle."""


def draw_picture(path: Path, world: World, arm: ArmModel, qpos: Array) -> str | None:
    """Draw a pose of the model of a run, (nq,), as PNG; return the reason why there is none, None else."""
    import PIL.Image  # a run without a picture does not wait for it

    spec = build(world, arm, for_pictures=True)
    tilt_rover(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    camera = "turret" if world.surface is None else "target"
    image = RayCamera(model, model.camera(camera).id, PICTURE_SIZE).take(data)
    try:
        with atomic_path(Path(os.path.realpath(path))) as part:  # a link stays a link
            PIL.Image.fromarray(image).save(part, "PNG")
    except OSError as error:
        return f"no picture: {path} cannot be written ({error.strerror or error})"
    return None


@contextmanager
def choose_log(files: RunFiles) -> Iterator[Path | None]:
    """Give the log of a run: that which is asked for, or one for the page alone, which is deleted.

    BadOutput if there is no folder for it.
    """
    if files.log is not None or files.page is None:
        yield files.log
        return
    try:
        scratch = TemporaryDirectory()
    except OSError as error:
        why = f"needs a folder for a temporary log ({error.strerror}); set TMPDIR, or record with --log"
        raise BadOutput(f"page {files.page}: {why}") from error
    with scratch as folder:
        yield Path(folder) / "run.mcap"


def write_page(log: Path, title: str, path: Path | None) -> str | None:
    """Write the page of the run of a log, None for none; return the reason why there is none, None else."""
    if path is None:
        return None
    from marsarm.view.page import save_page  # a run without a page does not wait for it
    from marsarm.view.watched_run import watch_log

    try:
        save_page(replace(watch_log(log), title=title), path)
    except UserError as error:
        return f"no page: {error}"
    return None


@dataclass(frozen=True, slots=True)
class Execution(Generic[Result]):
    """Run that was carried out."""

    result: Result
    params_sha256: str
    realtime_factor: float
    """Duration on Mars over wall time; 0 for a run that did not begin."""
    artifacts: Artifacts


def execution_not_begun(result: Result, arm: BuiltArm, files: RunFiles) -> Execution[Result]:
    """Return the record of a run that did not begin because its arm was not initialised."""
    reason = f"log {files.log}: not recorded (the arm was not initialised)"
    artifacts = Artifacts(log_problem=None if files.log is None else reason)
    return Execution(result, digest(arm.params), 0.0, artifacts)


def execute(
    run: Run[Result],
    loop: ClosedLoop,
    header: Mapping[str, str],
    files: RunFiles,
    world: World,
    progress: Progress,
    progress_at: Callable[[CycleRecord], tuple[float, float]],
    is_for_picture: Callable[[CycleRecord], bool],
    arm: ArmModel,
    title: str,
) -> Execution[Result]:
    """Carry out a run: record every cycle, then write page and picture.

    Args:
        progress_at: Function that returns the amount done at a cycle, and the total amount or GUESS.
        is_for_picture: Function that returns whether the picture may show a cycle; it shows the last one.

    Raises:
        BadRequest: the log cannot be opened; nothing moved.
    """
    running, qpos = part_of(progress, INITIALISATION_SHARE, 1.0 - DRAWING_SHARE), None
    named = (files.picture, files.page, files.log)
    replaced = frozenset(path for path in named if path is not None and path.exists())
    started = time.perf_counter()
    with choose_log(files) as log_path:
        step = SAMPLE_CYCLES if files.log is None else 1  # a log for the page alone is small
        with RunLog(log_path, header, loop.config.params, is_kept=files.log is not None) as log:
            for record in run:
                if record.tick % step == 0 or record.outputs.evrs or record.outputs.tool is not None:
                    log.write(record)
                loop.with_truth = log_path is not None and (record.tick + 1) % step == 0
                if record.tick % FRAME_CYCLES == 0:
                    activity = record.outputs.joint.mode.name.lower().replace("_", " ")
                    running(*progress_at(record), activity)
                if is_for_picture(record):
                    qpos = loop.plant.data.qpos.copy()
        wall_s = time.perf_counter() - started
        if loop.failure is not None:
            raise loop.failure
        problem = None if log_path is None else write_page(log_path, title, files.page)
        if problem is None and files.page is not None:
            problem = next((f"{files.page} plays to {e.from_s:.2f} s ({e.why})" for _, e in log.events), None)
    result = run.result()
    qpos = loop.plant.data.qpos if qpos is None else qpos
    undrawn = None if files.picture is None else draw_picture(files.picture, world, arm, qpos)
    artifacts = Artifacts(
        picture=files.picture if undrawn is None else None,
        picture_problem=undrawn,
        page=files.page if problem is None else None,
        page_problem=problem,
        replaced=replaced,
        log_problem=next((event.message for _, event in log.events), None) if files.log else None,
        events=log.events if files.log else (),
    )
    return Execution(result, loop.config.params_sha256, result.duration_s / wall_s, artifacts)
