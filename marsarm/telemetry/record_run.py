"""Recording of a run that a Python program carries out."""

from collections.abc import Callable
from pathlib import Path

from fsw.dictionary.commands import Command
from fsw.dictionary.validity import Wrong, read_arguments
from fsw.executive.context import known_names
from marsarm.telemetry.header import run_header
from marsarm.telemetry.json_codec import record_to_json
from marsarm.telemetry.recorder import Recorder
from sim.arms import UnknownArm, arm_named
from sim.effects.effect import Effect
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.sequence import SequenceResult, never, run_commands


def record_commands(
    path: Path | str, loop: ClosedLoop, *commands: Command, stop_when: Callable[[CycleRecord], bool] = never
) -> SequenceResult:
    """Run commands as `run_commands` does, and write the log of the run.

    Args:
        path: Log.
        loop: Run that has not begun.
        *commands: Commands; each starts when the last is done.
        stop_when: Monitor of every cycle; if it returns true, the arm is stopped instead of the remaining
            commands.

    Raises:
        LogNotWritable: the file cannot be written.
        ValueError: the run has begun, or flight software would refuse a command for an argument.
    """
    commands = tuple(_read_command(loop, command) for command in commands)
    setup = loop.setup
    drawn = _effects_by_name(setup.arm.name)
    added = [effect for effect in (*setup.arm.effects, *setup.effects) if effect not in drawn]
    about = {"world": record_to_json(setup.world)}
    header = run_header(loop, setup.arm.name, setup.seed, about, commands, added)
    with Recorder(Path(path), header, loop.config) as recorder:

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
