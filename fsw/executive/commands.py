"""What each command does, and when it is refused. A command is checked whole before anything moves."""

from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import (
    ClearFault,
    Command,
    GuardedMove,
    MoveJoints,
    MoveTool,
    Retract,
    SetReference,
    Stop,
    Unstow,
)
from fsw.dictionary.evrs import (
    BranchChosen,
    CommandAccepted,
    CommandCompleted,
    CommandRefused,
    Evr,
    FaultCleared,
    ReferenceSet,
)
from fsw.dictionary.joints import Tool
from fsw.dictionary.modes import Mode
from fsw.estimate.joints import JointEstimate, set_reference
from fsw.executive.modes import Event, after
from fsw.kinematics.transforms import Array
from fsw.motion.move import Move, stop
from fsw.motion.paths import Setpoint
from fsw.motion.plan import Plan, Refusal, plan_poses
from fsw.motion.plan_tool import plan_guarded, plan_retract, plan_tool


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What commands act on; each returns it changed."""

    mode: Mode
    tool: Tool
    joints: JointEstimate
    gap_rad: Array
    """What the set-points allow for."""
    move: Move | None
    evrs: tuple[Evr, ...] = ()


def handle(config: Config, now: Situation, command: Command) -> Situation:
    """The situation after a command: changed if it was accepted, with a reason if it was refused."""
    match command:
        case SetReference():
            return _set_reference(config, now, command)
        case ClearFault():
            return _clear_fault(now, command)
        case Stop():
            return _stop(config, now, command)
        case Unstow() | MoveJoints() | MoveTool() | GuardedMove() | Retract():
            return _begin_move(config, now, command)
        case _:
            assert_never(command)


MoveCommand = Unstow | MoveJoints | MoveTool | GuardedMove | Retract

_EVENT_OF: dict[type, Event] = {
    Unstow: Event.MOVE_FREE,
    MoveJoints: Event.MOVE_FREE,
    MoveTool: Event.MOVE_FREE,
    GuardedMove: Event.MOVE_GUARDED,
    Retract: Event.MOVE_BACK,
}


def _begin_move(config: Config, now: Situation, command: MoveCommand) -> Situation:
    mode = after(now.mode, _EVENT_OF[type(command)])
    problem = _not_now(now, mode) or _malformed(command)
    if problem is not None or mode is None:
        return _refused(now, command, problem or "")
    plan = _plan(config, now.joints, command)
    if isinstance(plan, Refusal):
        return _refused(now, command, plan.reason)
    tool = now.tool if isinstance(command, Unstow | MoveJoints) else command.tool
    move = Move(
        command=_name(command),
        end_mode=after(mode, Event.DONE) or mode,
        paths=plan.paths,
        hold=Setpoint(now.joints.motor_rad, np.zeros_like(now.joints.motor_rad)),
        guarded=tool if isinstance(command, GuardedMove) else None,
    )
    evrs: tuple[Evr, ...] = (CommandAccepted(_name(command)),)
    if plan.branch is not None:
        evrs = (*evrs, BranchChosen(tool, plan.branch))
    return replace(now, mode=mode, tool=tool, move=move, gap_rad=plan.gap_rad, evrs=(*now.evrs, *evrs))


def _not_now(now: Situation, mode: Mode | None) -> str | None:
    """Why no move can begin in this situation."""
    if now.mode is Mode.FAULTED:
        return "a fault stands; clear it first"
    if now.move is not None:
        return f"{now.move.command} is under way"
    if not now.joints.referenced:
        return "the encoders have no reference; set it first"
    if mode is None:
        return f"not allowed in mode {now.mode.name}"
    return None


def _malformed(command: MoveCommand) -> str | None:
    """What is wrong with the command's own numbers."""
    match command:
        case MoveJoints(angle_rad=angle):
            return None if np.all(np.isfinite(angle)) else "a joint angle is not finite"
        case MoveTool(p_RoTo_R_m=p, approach_R=a) | GuardedMove(end_p_RoTo_R_m=p, approach_R=a):
            if not (np.all(np.isfinite(p)) and np.all(np.isfinite(a))):
                return "position or approach is not finite"
            return None if np.linalg.norm(a) > 1e-9 else "the approach has no length"
        case Retract(distance_m=d):
            return None if np.isfinite(d) and 0 < d <= 1.0 else f"distance {d} m is outside 0 .. 1 m"
    return None


def _plan(config: Config, joints: JointEstimate, command: MoveCommand) -> Plan | Refusal:
    match command:
        case Unstow():
            poses = config.params.poses
            return plan_poses(config, joints, [np.array(p) for p in (*poses.unstow_via_rad, poses.ready_rad)])
        case MoveJoints():
            return plan_poses(config, joints, [np.array(command.angle_rad)])
        case MoveTool():
            return plan_tool(config, joints, command)
        case GuardedMove():
            return plan_guarded(config, joints, command)
        case Retract():
            return plan_retract(config, joints, command)
        case _:
            assert_never(command)


def _set_reference(config: Config, now: Situation, command: SetReference) -> Situation:
    if now.move is not None:
        return _refused(now, command, f"{now.move.command} is under way")
    if not np.all(np.isfinite(command.motor_rad)):
        return _refused(now, command, "a motor angle is not finite")
    if any(side not in (-1, 0, 1) for side in command.gap_side):
        return _refused(now, command, f"a gap side is not -1, 0 or 1: {command.gap_side}")
    joints = set_reference(config, now.joints, command)
    return replace(
        now,
        joints=joints,
        gap_rad=joints.gap_rad,
        evrs=(*now.evrs, ReferenceSet(), CommandCompleted(_name(command))),
    )


def _clear_fault(now: Situation, command: ClearFault) -> Situation:
    mode = after(now.mode, Event.CLEAR)
    if mode is None:
        return _refused(now, command, "no fault stands")
    if now.move is not None:
        return _refused(now, command, "the arm is still being stopped")
    return replace(now, mode=mode, evrs=(*now.evrs, FaultCleared(), CommandCompleted(_name(command))))


def _stop(config: Config, now: Situation, command: Stop) -> Situation:
    evrs = (*now.evrs, CommandCompleted(_name(command)))
    if now.move is None or now.mode is Mode.FAULTED:
        return replace(now, evrs=evrs)
    # a guarded or retracting arm may still touch, and stays where only a retraction is allowed
    end_mode = Mode.DEPLOYED if now.mode is Mode.FREE_SPACE else Mode.GUARDED
    return replace(now, move=stop(config, now.move, end_mode), evrs=evrs)


def _refused(now: Situation, command: Command, reason: str) -> Situation:
    return replace(now, evrs=(*now.evrs, CommandRefused(_name(command), reason)))


def _name(command: Command) -> str:
    return type(command).__name__
