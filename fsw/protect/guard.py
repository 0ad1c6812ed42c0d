"""The last stage: it may only reduce or stop."""

from dataclasses import replace

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import Evr, FaultResponse
from fsw.dictionary.modes import Mode
from fsw.estimate.joints import JointEstimate
from fsw.executive.modes import TRANSITIONS, Event
from fsw.kinematics.transforms import Array
from fsw.motion.move import Move, Phase
from fsw.motion.paths import Setpoint
from fsw.protect.responses import response_to


def guard(
    config: Config,
    mode: Mode,
    move: Move | None,
    last_rad: Array,
    joints: JointEstimate,
    evrs: tuple[Evr, ...],
) -> tuple[Mode, Move | None, tuple[Evr, ...]]:
    """Mode and move after the response that these events ask for; unchanged if they ask for none.

    `last_rad` is the last set-point that went out. A standing fault is not answered again: the arm is on
    its way to its brakes or on them.
    """
    response = response_to(evrs)
    if response is None or mode is Mode.FAULTED:
        return mode, move, ()
    stopped = None if move is None else brake(config, move, last_rad, joints)
    return TRANSITIONS[mode, Event.FAULT], stopped, (FaultResponse(response.value),)


def brake(config: Config, move: Move, last_rad: Array, joints: JointEstimate) -> Move:
    """The move with its brakes applied in this cycle, held where the motors are.

    A motor that lags is not driven on, and a reading that is the fault is not driven to: what is held is the
    reading, but no farther from the set-point than a motor may follow.
    """
    asked, bound = last_rad, config.params.monitors.following_error_rad
    return replace(
        move,
        phase=Phase.BRAKE,
        ticks=0 if move.phase is not Phase.BRAKE else move.ticks,
        hold=Setpoint(np.clip(joints.motor_rad, asked - bound, asked + bound), np.zeros_like(asked)),
        end_mode=Mode.FAULTED,
        guarded=None,
        stopped=True,
    )
