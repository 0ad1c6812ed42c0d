"""Clearing of a fault that is found again in the cycle of the command: it is refused.

Whether the fault is still there is known only after protection, at the end of the cycle. The cycle is then
computed again without the command, which is refused.
"""

from dataclasses import replace

from fsw.dictionary.commands import ClearFault, Command
from fsw.dictionary.evrs import CommandRefused, Evr, FaultCleared, FaultResponse
from fsw.dictionary.faults import Fault
from fsw.executive.context import command_name
from fsw.messages import Outputs
from fsw.state import State


def find_uncleared(evrs: tuple[Evr, ...]) -> Fault | None:
    """Find a fault that was found in the cycle in which one was cleared."""
    kinds = {type(evr) for evr in evrs}
    if not {FaultCleared, FaultResponse} <= kinds:
        return None
    return next(evr for evr in evrs if isinstance(evr, Fault))


def without_clear(commands: tuple[Command, ...]) -> tuple[Command, ...]:
    """Return the other commands of a cycle."""
    return tuple(one for one in commands if not isinstance(one, ClearFault))


def refuse_clear(
    cycle: tuple[State, Outputs], commands: tuple[Command, ...], fault: Fault
) -> tuple[State, Outputs]:
    """Refuse to clear a fault, before the events of the cycle that was computed without this command."""
    state, outputs = cycle
    reason = f"a fault was found in the same cycle: {fault.message}"
    refused = [CommandRefused(command_name(one), reason) for one in commands if isinstance(one, ClearFault)]
    return state, replace(outputs, evrs=(*refused, *outputs.evrs))
