"""A command sequence through the closed loop: the next command when the last is done."""

from collections.abc import Callable, Generator, Sequence
from enum import StrEnum
from typing import cast

from fsw.dictionary.commands import ClearFault, Command, Stop
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandRefused, FaultResponse
from sim.loop import ClosedLoop
from sim.record import CycleRecord


class Outcome(StrEnum):
    """How a sequence ended."""

    DONE = "done"
    REFUSED = "refused"
    FAULTED = "faulted"
    STOPPED = "stopped"
    SOFTWARE_ERROR = "software error"


def observe_cycles(
    cycles: Generator[CycleRecord, None, Outcome], note: Callable[[CycleRecord], None]
) -> Generator[CycleRecord, None, Outcome]:
    """The same cycles, each noted before it is handed on."""
    while True:
        try:
            record = next(cycles)
        except StopIteration as end:
            return cast(Outcome, end.value)
        note(record)
        yield record


def run_sequence(loop: ClosedLoop, commands: Sequence[Command]) -> Generator[CycleRecord, None, Outcome]:
    """Every cycle of the sequence; it ends with the first refusal or, brakes on, with a fault.

    A fault after which the sequence clears it does not end it, nor does one that only stopped the arm if the
    sequence says Stop after it: there is nothing to clear.

    Moves end by themselves, by contact, at their end or by a monitor; so a sequence always ends.
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


def stop_sequence(loop: ClosedLoop) -> Generator[CycleRecord, None, Outcome]:
    """Every cycle of a commanded stop, until the arm stands on its brakes."""
    record = loop.cycle((Stop(),))
    while True:
        yield record
        if loop.failure is not None:
            return Outcome.SOFTWARE_ERROR
        if not record.outputs.joint.busy:
            return Outcome.STOPPED
        record = loop.cycle()
