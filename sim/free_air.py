"""Moves in free air, where nothing is in the way; the arm is looked at when it has come to rest."""

from dataclasses import replace
from typing import Final

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import Command
from fsw.dictionary.evrs import CommandCompleted
from sim.effects.environment import NothingToTouch
from sim.loop import ClosedLoop, Setup
from sim.sequence import run_sequence

AWAKE_S: Final = 1.0
"""Before the first move, to know gravity."""
REST_S: Final = 2.0
"""On the brakes, before anything is looked at."""


def in_free_air(setup: Setup) -> ClosedLoop:
    """The run without rover, ground and rocks, which flight software knows; awake."""
    free = NothingToTouch()
    arm = replace(setup.arm, params=free.on_params(setup.arm.params))
    loop = ClosedLoop(replace(setup, arm=arm, effects=(*setup.effects, free)))
    _rest(loop, AWAKE_S)
    return loop


def rested_after(loop: ClosedLoop, command: Command) -> str | None:
    """Carry out a command and let the arm rest; or say why it did not come to its end."""
    evrs = [evr for record in run_sequence(loop, (command,)) for evr in record.outputs.evrs]
    if CommandCompleted(type(command).__name__) not in evrs:
        return evrs[-1].message
    _rest(loop, REST_S)
    return None


def _rest(loop: ClosedLoop, duration_s: float) -> None:
    for _ in range(round(duration_s * CYCLE_HZ)):
        loop.cycle()
