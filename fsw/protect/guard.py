"""The last stage: it may only reduce or stop."""

from dataclasses import replace

import numpy as np

from fsw.dictionary.evrs import Evr, FaultResponse
from fsw.dictionary.modes import Mode
from fsw.estimate.joints import JointEstimate
from fsw.executive.modes import Event, after
from fsw.motion.move import Move, Phase
from fsw.motion.paths import Setpoint
from fsw.protect.responses import response_to


def guard(
    mode: Mode, move: Move | None, joints: JointEstimate, evrs: tuple[Evr, ...]
) -> tuple[Mode, Move | None, tuple[Evr, ...]]:
    """Mode and move after the response that these events ask for; unchanged if they ask for none.

    A standing fault is not answered again: the arm is on its way to its brakes or on them.
    """
    response = response_to(evrs)
    if response is None or mode is Mode.FAULTED:
        return mode, move, ()
    faulted = after(mode, Event.FAULT) or Mode.FAULTED
    return faulted, None if move is None else brake(move, joints), (FaultResponse(response.value),)


def brake(move: Move, joints: JointEstimate) -> Move:
    """The move with its brakes applied in this cycle, held where the motors were last seen."""
    return replace(
        move,
        phase=Phase.BRAKE,
        ticks=0 if move.phase is not Phase.BRAKE else move.ticks,
        hold=Setpoint(joints.motor_rad, np.zeros_like(joints.motor_rad)),
        end_mode=Mode.FAULTED,
        guarded=None,
        stopped=True,
    )
