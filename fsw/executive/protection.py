"""Interface to protection: describe the arm in plain values, and apply the decision to the move."""

from dataclasses import replace
from typing import assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandAborted, Evr
from fsw.dictionary.types import cycle_record
from fsw.estimate.gear import LIKELY
from fsw.estimate.joints import JointEstimate
from fsw.executive.context import TRANSITIONS, ModeEvent, command_name, stop_event
from fsw.kinematics.transforms import Array
from fsw.motion.move import NO_JOINTS, Move, Phase, distance_travelled, stop_early
from fsw.motion.paths import LinePath, Setpoint
from fsw.motion.preload import PreloadState
from fsw.protect.inputs import ArmStatus, MoveStatus, PressStatus
from fsw.protect.responses import Decision, Response, StandingFault
from fsw.state import Planning, Sequence


@cycle_record
class MoveOutcome:
    """Mode, planning, move, sequence and standing fault after a move has advanced, and its events."""

    mode: Mode
    planning: Planning | None
    move: Move | None
    sequence: Sequence | None
    fault: StandingFault | None
    evrs: tuple[Evr, ...]


def describe_arm(
    mode: Mode,
    tool: str,
    joints: JointEstimate,
    backlash_state: Array,
    move: Move | None,
    preload: PreloadState | None,
) -> ArmStatus:
    """Describe the arm to protection in plain values; arrays are those of the arguments, not copies."""
    reference = joints.reference
    # positional arguments, because they are faster and this runs in every cycle
    return ArmStatus(
        mode,
        tool,
        reference.calibrated,
        joints.motor_rad,
        joints.motor_rate_rad_s,
        joints.gear_rad[:, LIKELY],
        joints.bounds.lowest_rad[:, LIKELY],
        joints.bounds.highest_rad[:, LIKELY],
        backlash_state[2],
        backlash_state[1],
        reference.half_backlash_rad,
        joints.resolver_error_rad,
        reference.resolver_bias_rad,
        joints.gravity_R_m_s2,
        joints.imu_R_m_s2,
        None if move is None else _describe_move(move, preload),
    )


def _describe_move(move: Move, preload: PreloadState | None) -> MoveStatus:
    plan, press = move.plan, None
    if plan.preload_change is not None and not plan.stopped and preload is not None:
        press = PressStatus(
            preload.tool, preload.force_N, plan.preload_change.torque_per_N, preload.resolver_offset_rad
        )
    # a guarded tool approaches while it moves along its line and has not touched
    on_line = move.phase is Phase.RUN and not plan.touched and plan.guarded_tool is not None
    return MoveStatus(
        move.setpoint.motor_rad,
        move.setpoint.rate_rad_s,
        plan.stopped,
        move.phase is Phase.RELEASE,
        None if move.homing is None else move.homing.joint,
        plan.guarded_tool if on_line and isinstance(plan.paths[0], LinePath) else None,
        press,
    )


def apply_decision(
    config: Config, before: MoveOutcome, decision: Decision, joints: JointEstimate
) -> MoveOutcome:
    """Apply the decision of protection to mode, move and sequence."""
    match decision.response:
        case None:
            return replace(before, fault=decision.fault, evrs=decision.evrs)
        case Response.STOP_AND_BRAKE:
            return _stop(config, before, decision, joints)
        case Response.BRAKE_AND_REFUSE | Response.POWER_OFF:
            return replace(
                before,
                mode=TRANSITIONS[before.mode, ModeEvent.FAULT],
                move=None if before.move is None else _brake(before.move, decision),
                fault=decision.fault,
                evrs=decision.evrs,
            )
        case _:
            assert_never(decision.response)


def _stop(config: Config, before: MoveOutcome, decision: Decision, joints: JointEstimate) -> MoveOutcome:
    """Stop move or planning as a commanded stop does; a move that already stops is left as it is."""
    mode, move, evrs = before.mode, before.move, decision.evrs
    if before.sequence is not None:
        evrs = (*evrs, CommandAborted(before.sequence.command))
    elif before.planning is not None:
        evrs = (*evrs, CommandAborted(command_name(before.planning.command)))
    if before.planning is not None:
        mode = before.planning.rest_mode
    if move is not None and not move.plan.stopped:
        move = stop_early(config, move, TRANSITIONS[before.mode, stop_event(config, before.mode, joints)])
        if move.phase is Phase.SETTLE:
            move = replace(move, phase=Phase.BRAKE, ticks=0)
    return MoveOutcome(mode, None, move, None, decision.fault, evrs)


def _brake(move: Move, decision: Decision) -> Move:
    """Apply the brakes in this cycle, with the set-point that protection decided."""
    plan = replace(
        move.plan,
        active=NO_JOINTS if decision.response is Response.POWER_OFF else move.plan.active,
        travelled=distance_travelled(move),
        end_mode=Mode.FAULTED,
        guarded_tool=None,
        stopped=True,
    )
    return replace(
        move,
        plan=plan,
        phase=Phase.BRAKE,
        ticks=0 if move.phase is not Phase.BRAKE else move.ticks,
        setpoint=Setpoint(decision.hold_rad, np.zeros_like(decision.hold_rad)),
    )
