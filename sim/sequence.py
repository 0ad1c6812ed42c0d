"""Command sequences in the closed loop; a command starts when the last is done."""

from collections.abc import Callable, Generator, Sequence
from enum import StrEnum
from typing import cast

from fsw.dictionary.commands import ClearFault, Command, Stop
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandRefused, FaultResponse
from sim.loop import ClosedLoop
from sim.record import CycleRecord


class Outcome(StrEnum):
    """Outcome of a sequence."""

    DONE = "done"
    REFUSED = "refused"
    FAULTED = "faulted"
    STOPPED = "stopped"
    SOFTWARE_ERROR = "software error"


def observe_cycles(
    cycles: Generator[CycleRecord, None, Outcome], note: Callable[[CycleRecord], None]
) -> Generator[CycleRecord, None, Outcome]:
    """Pass cycles on, after a call of `note` with each."""
    while True:
        try:
            record = next(cycles)
        except StopIteration as end:
            return cast(Outcome, end.value)
        note(record)
        yield record


def run_sequence(loop: ClosedLoop, commands: Sequence[Command]) -> Generator[CycleRecord, None, Outcome]:
    """Run a sequence until its end, the first refusal, or a fault with brakes on.

    A fault does not end it if the next command clears it.
    A fault that only stopped the arm does not end it if the next command is Stop: there is nothing to clear.
    Every move ends by contact, at its goal or by a monitor; so a sequence always ends.

    Yields:
        Every cycle.

    Returns:
        The outcome.
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
    """Run a commanded stop until the arm rests on its brakes.

    Yields:
        Every cycle.

    Returns:
        The outcome.
    """
    record = loop.cycle((Stop(),))
    while True:
        yield record
        if loop.failure is not None:
            return Outcome.SOFTWARE_ERROR
        if not record.outputs.joint.busy:
            return Outcome.STOPPED
        record = loop.cycle()
