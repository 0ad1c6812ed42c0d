"""Recorder of a run into an MCAP log that stays readable if the run is killed, and the header of a log.

The header has software, processor, start conditions of flight software, commands and plant.
"""

import ctypes
import hashlib
import json
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from fcntl import F_DUPFD_CLOEXEC, fcntl
from functools import cache
from importlib.metadata import version
from io import FileIO
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self
from weakref import finalize

import mujoco
import numpy as np
from numpy._core._multiarray_umath import __cpu_features__ as NUMPY_FEATURES  # type: ignore[import-not-found]

from fsw.dictionary.arguments import Wrong, read_arguments
from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Mode
from fsw.dictionary.params import Params, digest
from fsw.estimate.reference import Reference
from fsw.executive.context import known_names
from marsarm.telemetry.events import command_entry, evr_entry, record_to_json
from marsarm.telemetry.format import (
    CHUNK_CYCLES,
    COMMAND_TOPIC,
    EVR_TOPIC,
    TICK_NS,
    WRITER_KEY,
    LogNotWritable,
    end_metadata,
)
from marsarm.telemetry.log_writer import ChunkWriter, Packer
from marsarm.telemetry.schema import arm_names
from marsarm.telemetry.topics import PACKET_TOPICS, TopicSpec, begin_log, topic_specs
from sim.arms import UnknownArm, arm_named, nominal_params
from sim.effects.effect import Effect
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.scenario.effects import effect_text
from sim.sequence import SequenceResult, never, run_commands
from sim.setting import World
from simgap.common.errors import BadOutput
from simgap.common.files import atomic_path, check_output, check_unlocked, lock_file
from simgap.common.interruption import defer_interrupts, describe_interruption
from simgap.common.origin import git_revision


@cache
def cpu_features() -> tuple[str, ...]:
    """Return the machine, the instruction sets that numpy uses, and the kernels of its OpenBLAS."""
    features = sorted(name for name, is_used in NUMPY_FEATURES.items() if is_used)
    return (platform.machine(), *features, f"OpenBLAS {_blas_kernels()}")


def _blas_kernels() -> str:
    """Return the kernels of OpenBLAS, which decide the last digits of sums; "unknown" for another library."""
    folder = Path(np.__file__).parents[1] / "numpy.libs"
    for library in sorted(folder.glob("libscipy_openblas*")):
        try:
            core_name = ctypes.CDLL(str(library)).scipy_openblas_get_corename64_
        except (OSError, AttributeError):
            continue
        core_name.restype = ctypes.c_char_p
        return str(core_name().decode())
    return "unknown"


WORLD: Final = "world"
"""Key of the header: scene, tilt of the rover and surface as JSON, for viewers."""
SESSION: Final = "session"
"""Key of the header: motion and conditions of a session as JSON, for the diagnosis."""
IMPORT: Final = "import"
"""Key of the request of a log that was made of a table: its files and their digests."""


def run_header(
    loop: ClosedLoop,
    arm: str,
    seed: int,
    request: dict[str, Any],
    commands: Sequence[Command],
    effects: Sequence[Effect] = (),
    world: World | None = None,
) -> dict[str, str]:
    """Return the header of a run, with effects beyond the arm's; ValueError if it has begun."""
    return {
        **flight_header(loop, commands),
        "arm": arm,
        "seed": str(seed),
        "request": json.dumps(request, default=str, sort_keys=True),
        "effects": json.dumps([effect_text(effect) for effect in effects]),
        "mjcf_sha256": model_digest(loop.plant.model),
        **({} if world is None else {WORLD: json.dumps(record_to_json(world))}),
    }


def flight_header(loop: ClosedLoop, commands: Sequence[Command]) -> dict[str, str]:
    """Return what knows nothing of the plant: versions, start, commands; ValueError if the run has begun."""
    if loop.state.tick != 0:
        raise ValueError(f"the run is at tick {loop.state.tick}; a log begins with flight software's first")
    return {
        **versions_header(),
        **start_header(loop.config.params, loop.state.mode, loop.state.joints.reference),
        **commands_header(commands),
    }


def versions_header() -> dict[str, str]:
    """Return the versions of the software, and the processor."""
    return {
        WRITER_KEY: version("marsarm"),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "cpu": json.dumps(cpu_features()),
        "git": git_revision(),
    }


def start_header(params: Params, mode: Mode, reference: Reference | None) -> dict[str, str]:
    """Return the start conditions of flight software: all that replay needs besides sensors and commands."""
    boot = {"mode": mode.name, "reference": None if reference is None else record_to_json(reference)}
    return {
        "params": json.dumps(record_to_json(params)),
        "params_sha256": digest(params),
        "boot": json.dumps(boot),
    }


def commands_header(commands: Sequence[Command]) -> dict[str, str]:
    """Return a command sequence and its digest."""
    text = json.dumps([{"type": type(c).__name__, "fields": record_to_json(c)} for c in commands])
    return {"commands": text, "commands_sha256": hashlib.sha256(text.encode()).hexdigest()}


def model_digest(model: mujoco.MjModel) -> str:
    """Compute the SHA-256 of the compiled plant: models/mjcf, the world and the effects."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.data).hexdigest()


NOT_CLOSED: Final = "a recorder that nobody closed"
"""Cause of an interruption if the program ended without an exception that it could report."""


def create_log(
    path: Path, header: Mapping[str, str], channels: tuple[TopicSpec, ...], chunk_cycles: int
) -> ChunkWriter:
    """Replace a file by a log with header and channels; LogNotWritable, and the old file, if that fails."""
    try:
        target = Path(os.path.realpath(path))  # a link stays a link
        check_output(target, (target.suffix.lower(),), "log")
        check_unlocked(target, "log")
        with ExitStack() as on_failure:
            with atomic_path(target) as part:
                file = on_failure.enter_context(FileIO(part, "xb", opener=_open_above_stdio))
                lock_file(file.fileno())  # it is new; the lock lasts until the log is complete
                log = begin_log(file, header, channels, chunk_cycles=chunk_cycles)
            on_failure.pop_all()
            return log
    except BadOutput as error:
        raise LogNotWritable(path, str(error).partition(": ")[2]) from error
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise LogNotWritable(path, f"cannot be written ({why}); give a path with room") from error


def _open_above_stdio(path: str, flags: int) -> int:
    """Open a file with a descriptor above 2, which nobody takes for a standard stream that was closed."""
    descriptor = os.open(path, flags, 0o666)
    try:
        return fcntl(descriptor, F_DUPFD_CLOEXEC, 3)
    finally:
        os.close(descriptor)


class Recorder:
    """Log being written; a context manager, or call `close`. The file depends only on the cycles."""

    def __init__(
        self,
        path: Path | str,
        header: Mapping[str, str],
        params: Params | None = None,
        chunk_cycles: int = CHUNK_CYCLES,
    ) -> None:
        """Replace the file at `path` by a log with header and channels.

        Args:
            header: Versions, digests, seed and more, as `run_header` returns them.
            params: Flight parameters, whose tools and switches messages have; None for the default arm's.
            chunk_cycles: Cycles in a chunk; a killed run loses less than a chunk.

        Raises:
            LogNotWritable: no log can be written at this path; a previous file is unchanged.
        """
        self.path = Path(path)
        channels = topic_specs(arm_names(params or nominal_params()))
        self._ids = {one.topic: one.id for one in channels}
        self._packers = [
            (one.id, attrgetter(path := PACKET_TOPICS[one.topic].path), Packer(path, one.layout))
            for one in channels
            if one.layout is not None
        ]
        self._last_tick = -1
        self._process = os.getpid()
        self._log = create_log(self.path, header, channels, chunk_cycles)
        # A recorder without references closes itself, for nobody can say any more that the run is done.
        self._finalizer = finalize(self, _finish, self._log, self._process, NOT_CLOSED)

    @property
    def written_cycles(self) -> int:
        """Tick after the last cycle in the file; 0 without a cycle."""
        last_ns = self._log.written_ns
        return 0 if last_ns is None else last_ns // TICK_NS + 1

    def write(self, record: CycleRecord) -> None:
        """Add one cycle; the operating system receives its messages when the chunk closes.

        Raises:
            SchemaError: a packet differs from its layout, or a value cannot be recorded.
            OSError: the disk is full or gone.
            ValueError: the log is closed, or the tick does not rise.
            RuntimeError: another process opened the log.
        """
        if os.getpid() != self._process:
            raise RuntimeError("a log is written by the process that opened it; open another here")
        if not self._finalizer.alive:
            raise ValueError("the log is closed; open another to record more")
        if record.tick <= self._last_tick:
            raise ValueError(f"cycle {record.tick} after cycle {self._last_tick}: a log goes forward")
        time_ns = record.tick * TICK_NS
        messages = [*self._messages(record)]
        with defer_interrupts:
            self._last_tick = record.tick
            self._log.add(time_ns, messages)

    def close(self, interrupted_by: str = "") -> None:
        """Write the waiting cycles and the summary, and close the file; a second call does nothing.

        Args:
            interrupted_by: Cause if the run was interrupted, which the log then says; empty if it was not.

        Raises:
            OSError: the disk is full or gone.
        """
        if self._finalizer.detach() is not None:
            with defer_interrupts:
                _finish(self._log, self._process, interrupted_by)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close("" if error is None else describe_interruption(error))

    def _messages(self, record: CycleRecord) -> Iterator[tuple[int, bytes]]:
        """Yield channel and body of the commands, then of the packets, then of the EVRs."""
        ids = self._ids
        for command in record.commands:
            yield ids[COMMAND_TOPIC], command_entry(record.tick, command).encode()
        for channel, packet_in, packer in self._packers:
            packet = packet_in(record)
            if packet is not None:
                yield channel, packer.pack(packet)
        for evr in record.outputs.evrs:
            yield ids[EVR_TOPIC], evr_entry(record.tick, evr).encode()


def _finish(log: ChunkWriter, process: int, interrupted_by: str) -> None:
    if os.getpid() == process:
        log.finish(end_metadata(interrupted_by))
    else:  # a fork must not complete the log
        log.close()


def record_commands(
    path: Path | str, loop: ClosedLoop, *commands: Command, stop_when: Callable[[CycleRecord], bool] = never
) -> SequenceResult:
    """Run commands as `run_commands` does, and write the log; LogNotWritable, or ValueError for a command."""
    commands = tuple(_read_command(loop, command) for command in commands)
    setup = loop.setup
    drawn = _effects_by_name(setup.arm.name)
    added = [effect for effect in (*setup.arm.effects, *setup.effects) if effect not in drawn]
    about = {"world": record_to_json(setup.world)}
    header = run_header(loop, setup.arm.name, setup.seed, about, commands, added)
    with Recorder(path, header, loop.config.params) as recorder:

        def observe(record: CycleRecord) -> bool:
            recorder.write(record)
            return stop_when(record)

        return run_commands(loop, *commands, stop_when=observe)


def _read_command(loop: ClosedLoop, command: Command) -> Command:
    """Return a command with plain values, which a log can hold."""
    read = read_arguments(command, known_names(loop.config.params))
    if isinstance(read, Wrong):
        raise ValueError(f"{type(command).__name__}: {read.text}")
    return read


def _effects_by_name(name: str) -> tuple[Effect, ...]:
    """Return the effects that the name of an arm stands for; none for an arm of the program itself."""
    try:
        return arm_named(name).effects
    except UnknownArm:
        return ()
