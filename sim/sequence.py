"""Command sequences in the closed loop; a command starts when the last is done."""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import ClearFault, Command, Stop
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandRefused, Evr, FaultResponse
from sim.loop import ClosedLoop
from sim.record import CycleRecord


class Outcome(StrEnum):
    """Outcome of a sequence."""

    DONE = "done"
    REFUSED = "refused"
    FAULTED = "faulted"
    STOPPED = "stopped"
    SOFTWARE_ERROR = "software error"


@dataclass(frozen=True, slots=True, eq=False)
class SequenceResult:
    """Outcome of a sequence, with every cycle."""

    outcome: Outcome
    cycles: tuple[CycleRecord, ...]

    @property
    def evrs(self) -> tuple[tuple[float, Evr], ...]:
        """Return time [s] and event of each event report."""
        return tuple((one.tick / CYCLE_HZ, evr) for one in self.cycles for evr in one.outputs.evrs)

    def series(self, name: str) -> tuple[NDArray[np.float64], NDArray[Any]]:
        """Return the values of a field in all cycles that have it.

        Args:
            name: Path from `CycleRecord`, such as `outputs.joint.motor_rad` or `truth.contact_force_N`.

        Returns:
            Times in seconds, shape (n,), and values in the unit of the field, shape (n, ...).

        Raises:
            AttributeError: there is no such field.
        """
        values = [(one.tick / CYCLE_HZ, _field(one, name)) for one in self.cycles]
        known = [(time_s, value) for time_s, value in values if value is not None]
        return np.array([time_s for time_s, _ in known]), np.array([value for _, value in known])


def _field(record: CycleRecord, name: str) -> Any:
    """Return the field with this path; None if a record on the way is None, as `tool` is in some cycles."""
    value: Any = record
    for key in name.split("."):
        value = None if value is None else getattr(value, key)
    return value


def run_sequence(loop: ClosedLoop, commands: Sequence[Command]) -> Generator[CycleRecord, None, Outcome]:
    """Run a sequence until its end, the first refusal, or a fault with brakes on.

    A fault does not end it if the next command clears it.
    A fault that only stopped the arm does not end it if the next command is Stop: there is nothing to clear.
    Every move ends by contact, at its end or by a monitor; so a sequence always ends.
    """
    faulted = False
    for number, command in enumerate(commands):
        record = loop.cycle((command,))
        while True:
            yield record
            if loop.failure is not None:
                return Outcome.SOFTWARE_ERROR
            if any(isinstance(evr, CommandRefused) for evr in record.outputs.evrs):
                return Outcome.REFUSED
            faulted = faulted or any(isinstance(evr, FaultResponse) for evr in record.outputs.evrs)
            if not record.outputs.joint.busy:
                break
            record = loop.cycle()
        stands = loop.state.mode is Mode.FAULTED
        clears = number + 1 < len(commands) and isinstance(
            commands[number + 1], ClearFault if stands else Stop
        )
        if faulted and not clears:
            return Outcome.FAULTED
        faulted = False
    return Outcome.DONE


class SequenceRun:
    """Sequence in a closed loop, cycle by cycle; what it says of itself is complete after the last cycle."""

    def __init__(self, loop: ClosedLoop, commands: Sequence[Command]):
        self.loop, self.commands = loop, commands
        self.outcome = Outcome.SOFTWARE_ERROR
        self.evrs: list[tuple[float, Evr]] = []
        """Time [s] and event."""

    def __iter__(self) -> Iterator[CycleRecord]:
        """Run all cycles."""
        for record in self._run():
            self.evrs += [(record.tick / CYCLE_HZ, evr) for evr in record.outputs.evrs]
            self.note(record)
            yield record

    def _run(self) -> Iterator[CycleRecord]:
        self.outcome = yield from run_sequence(self.loop, self.commands)

    def note(self, record: CycleRecord) -> None:
        """Note what a cycle shows."""


def stop_sequence(loop: ClosedLoop) -> Generator[CycleRecord, None, Outcome]:
    """Run a commanded stop until the arm rests on its brakes."""
    record = loop.cycle((Stop(),))
    while True:
        yield record
        if loop.failure is not None:
            return Outcome.SOFTWARE_ERROR
        if not record.outputs.joint.busy:
            return Outcome.STOPPED
        record = loop.cycle()


def never(_: CycleRecord) -> bool:
    """Stop in no cycle."""
    return False


def run_commands(
    loop: ClosedLoop, *commands: Command, stop_when: Callable[[CycleRecord], bool] = never
) -> SequenceResult:
    """Run commands one after the other, and keep every cycle.

    Args:
        *commands: Commands; each starts when the last is done.
        stop_when: Monitor of every cycle; if it returns true, the arm is stopped instead of the remaining
            commands.
    """
    cycles: list[CycleRecord] = []
    sequence, is_stopping = run_sequence(loop, commands), False
    while True:
        try:
            record = next(sequence)
        except StopIteration as end:
            return SequenceResult(cast(Outcome, end.value), tuple(cycles))
        cycles.append(record)
        if not is_stopping and stop_when(record):
            sequence, is_stopping = stop_sequence(loop), True
