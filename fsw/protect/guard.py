"""The last stage: it may only reduce or stop."""

from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import CommandAborted, Evr, FaultResponse
from fsw.dictionary.faults import ContactInFreeSpace
from fsw.dictionary.modes import Mode
from fsw.estimate.joints import JointEstimate
from fsw.executive.modes import TRANSITIONS, Event
from fsw.executive.sequence import Sequence
from fsw.executive.stow import stop_event
from fsw.kinematics.transforms import Array
from fsw.motion.drive import NONE
from fsw.motion.move import Move, Phase, gone, stop
from fsw.motion.paths import Setpoint
from fsw.protect.responses import Response, response_to

Kind = tuple[type[Evr], object]
"""An event's class, and the joint, sensor or switch that it is about."""


@dataclass(frozen=True, slots=True)
class StandingFault:
    """A fault that the ground has not cleared: where it happened and what has been reported since."""

    mode: Mode
    reported: frozenset[Kind]

    @property
    def may_touch(self) -> bool:
        """Whether the arm may be in contact with something."""
        on_contact = any(event is ContactInFreeSpace for event, _ in self.reported)
        return on_contact or self.mode in (Mode.GUARDED, Mode.RETRACTING, Mode.PRELOAD)


def kind_of(evr: Evr) -> Kind:
    """What makes two events the same news."""
    about = next((getattr(evr, name) for name in ("joint", "sensor", "switch") if hasattr(evr, name)), None)
    return type(evr), about


@dataclass(frozen=True, slots=True, eq=False)
class Guarded:
    """Mode, move, sequence and fault after protection, and the events to report."""

    mode: Mode
    move: Move | None
    sequence: Sequence | None
    fault: StandingFault | None
    evrs: tuple[Evr, ...]


def guard(
    config: Config,
    before: Guarded,
    last_rad: Array,
    joints: JointEstimate,
    found: tuple[Evr, ...],
) -> Guarded:
    """What is left of mode and move after the response that the found events ask for.

    `last_rad` is the last set-point that went out. A standing fault is not answered again, for the arm is on
    its way to its brakes or on them; what it brings that was not reported yet still is.
    """
    if before.fault is not None:
        new = tuple(evr for evr in found if kind_of(evr) not in before.fault.reported)
        if not new:
            return before
        reported = before.fault.reported | {kind_of(evr) for evr in new}
        return replace(before, fault=replace(before.fault, reported=reported), evrs=new)
    response, move = response_to(found), before.move
    match response:
        case None:
            return replace(before, evrs=found)
        case Response.STOP_AND_BRAKE:
            return _stopped(config, replace(before, evrs=(*found, FaultResponse(response.value))), joints)
        case Response.BRAKE_AND_REFUSE | Response.POWER_OFF:
            if move is not None:
                move = brake(config, move, last_rad, joints)
                if response is Response.POWER_OFF:
                    move = replace(move, active=NONE)
            return Guarded(
                mode=TRANSITIONS[before.mode, Event.FAULT],
                move=move,
                sequence=before.sequence,
                fault=StandingFault(before.mode, frozenset(kind_of(evr) for evr in found)),
                evrs=(*found, FaultResponse(response.value)),
            )
        case _:
            assert_never(response)


def _stopped(config: Config, before: Guarded, joints: JointEstimate) -> Guarded:
    """As after a commanded stop; what is being stopped already goes on as it is."""
    sequence, move, evrs = before.sequence, before.move, before.evrs
    if sequence is not None:
        evrs = (*evrs, CommandAborted(sequence.command))
    if move is not None and not move.stopped:
        move = stop(config, move, TRANSITIONS[before.mode, stop_event(config, before.mode, joints)])
        if move.phase is Phase.SETTLE:
            move = replace(move, phase=Phase.BRAKE, ticks=0)
    return replace(before, move=move, sequence=None, evrs=evrs)


def brake(config: Config, move: Move, last_rad: Array, joints: JointEstimate) -> Move:
    """The move with its brakes applied in this cycle, held where the motors are.

    A motor that lags is not driven on, and a reading that is the fault is not driven to: what is held is the
    reading, but no farther from the set-point than a motor may follow.
    """
    asked, bound = last_rad, config.params.monitors.following_error_rad
    return replace(
        move,
        phase=Phase.BRAKE,
        travelled=gone(move),
        ticks=0 if move.phase is not Phase.BRAKE else move.ticks,
        hold=Setpoint(np.clip(joints.motor_rad, asked - bound, asked + bound), np.zeros_like(asked)),
        end_mode=Mode.FAULTED,
        guarded=None,
        stopped=True,
    )
