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
from fsw.dictionary.joints import Joint, Tool
from fsw.dictionary.modes import Mode
from fsw.estimate.joints import JointEstimate, gap_to_move, set_reference
from fsw.executive.modes import Event, after
from fsw.kinematics.statics import settle
from fsw.kinematics.transforms import Array
from fsw.motion.move import Move, stop
from fsw.motion.paths import JointPath, Path, Setpoint, joint_path, line_path
from fsw.motion.plan import LinePlan, Refusal, plan_guarded, plan_retract, plan_tool


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What commands act on; each returns it changed."""

    mode: Mode
    tool: Tool
    joints: JointEstimate
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
    planned = _plan(config, now, command)
    if isinstance(planned, Refusal):
        return _refused(now, command, planned.reason)
    paths, tool, evrs = planned
    move = Move(
        command=_name(command),
        end_mode=after(mode, Event.DONE) or mode,
        paths=paths,
        hold=Setpoint(now.joints.motor_rad, np.zeros_like(now.joints.motor_rad)),
        guarded=tool if isinstance(command, GuardedMove) else None,
    )
    return replace(
        now, mode=mode, tool=tool, move=move, evrs=(*now.evrs, CommandAccepted(_name(command)), *evrs)
    )


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


Planned = tuple[tuple[Path, ...], Tool, tuple[Evr, ...]]


def _plan(config: Config, now: Situation, command: MoveCommand) -> Planned | Refusal:
    poses = config.params.poses
    match command:
        case Unstow():
            legs = _legs(
                config, now.joints, [*map(np.array, poses.unstow_via_rad), np.array(poses.ready_rad)]
            )
            return legs if isinstance(legs, Refusal) else (legs, now.tool, ())
        case MoveJoints():
            legs = _legs(config, now.joints, [np.array(command.angle_rad)])
            return legs if isinstance(legs, Refusal) else (legs, now.tool, ())
        case MoveTool():
            goal = plan_tool(config, now.joints, command)
            if isinstance(goal, Refusal):
                return goal
            path = joint_path(config, now.joints.motor_rad, goal.motor_rad)
            return (path,), command.tool, (BranchChosen(command.tool, goal.branch),)
        case GuardedMove():
            guarded = plan_guarded(config, now.joints, command)
            return _line(config, guarded, command.tool, config.params.motion.guarded_speed_m_s)
        case Retract():
            back = plan_retract(config, now.joints, command)
            return _line(config, back, command.tool, config.params.motion.retract_speed_m_s)
        case _:
            assert_never(command)


def _line(config: Config, line: LinePlan | Refusal, tool: Tool, speed_m_s: float) -> Planned | Refusal:
    if isinstance(line, Refusal):
        return line
    return (line_path(config, line.motor_rad, line.length_m, speed_m_s),), tool, ()


def _legs(config: Config, joints: JointEstimate, outputs: list[Array]) -> tuple[JointPath, ...] | Refusal:
    """Joint moves from pose to pose, with the motor angles that hold each pose at the output."""
    low, high = config.arm.soft_min_rad, config.arm.soft_max_rad
    legs, start, last, gap = [], joints.motor_rad, joints.motor_rad + joints.gap_rad, joints.gap_rad
    for output in outputs:
        for joint in Joint:
            if not low[joint] <= output[joint] <= high[joint]:
                return Refusal(
                    f"joint {joint.name.lower()}: {np.degrees(output[joint]):.1f} deg is outside "
                    f"its soft limits {np.degrees(low[joint]):.1f} .. {np.degrees(high[joint]):.1f} deg"
                )
        torque = settle(config.arm, output, np.zeros_like(output), joints.gravity_R_m_s2).torque_Nm
        gap = gap_to_move(config, torque, gap, output - last)
        motor = output - gap - torque / config.arm.gear_stiffness_Nm_rad
        legs.append(joint_path(config, start, motor))
        start, last = motor, output
    return tuple(legs)


def _set_reference(config: Config, now: Situation, command: SetReference) -> Situation:
    if now.move is not None:
        return _refused(now, command, f"{now.move.command} is under way")
    if not np.all(np.isfinite(command.motor_rad)):
        return _refused(now, command, "a motor angle is not finite")
    if any(side not in (-1, 0, 1) for side in command.gap_side):
        return _refused(now, command, f"a gap side is not -1, 0 or 1: {command.gap_side}")
    joints = set_reference(config, now.joints, command)
    return replace(now, joints=joints, evrs=(*now.evrs, ReferenceSet(), CommandCompleted(_name(command))))


def _clear_fault(now: Situation, command: ClearFault) -> Situation:
    mode = after(now.mode, Event.CLEAR)
    if mode is None:
        return _refused(now, command, "no fault stands")
    if now.move is not None:
        return _refused(now, command, "the arm is still being stopped")
    return replace(now, mode=mode, evrs=(*now.evrs, FaultCleared(), CommandCompleted(_name(command))))


def _stop(config: Config, now: Situation, command: Stop) -> Situation:
    evrs = (*now.evrs, CommandCompleted(_name(command)))
    if now.move is None:
        return replace(now, evrs=evrs)
    # a guarded or retracting arm may still touch, and stays where only a retraction is allowed
    end_mode = Mode.DEPLOYED if now.mode is Mode.FREE_SPACE else Mode.GUARDED
    return replace(now, move=stop(config, now.move, end_mode), evrs=evrs)


def _refused(now: Situation, command: Command, reason: str) -> Situation:
    return replace(now, evrs=(*now.evrs, CommandRefused(_name(command), reason)))


def _name(command: Command) -> str:
    return type(command).__name__
