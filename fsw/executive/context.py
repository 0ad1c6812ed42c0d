"""Context of a command: the mode machine, the checks that commands share, and the settings: tilt, parameters.

The types and limits of single arguments are checked where a command arrives (dictionary/arguments.py).
"""

from dataclasses import dataclass, fields, is_dataclass, replace
from enum import IntEnum
from typing import Any, Final

import numpy as np

from fsw.config import Config, configure, configure_at
from fsw.dictionary.arguments import Names
from fsw.dictionary.commands import (
    ROVER,
    Command,
    Dock,
    GuardedMove,
    MoveJoint,
    MoveJoints,
    MoveTeachPoint,
    MoveTool,
    PlaceTool,
    Preload,
    Process,
    Retract,
    SetParam,
    SetTilt,
    Stow,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import Frame, Joint, Mode
from fsw.dictionary.evrs import CommandAccepted, CommandCompleted, CommandRefused, Evr, ParamSet, TiltSet
from fsw.dictionary.params import Params
from fsw.dictionary.types import AUTO, NameMark
from fsw.dictionary.validity import check_arm, check_limits
from fsw.estimate.joints import JointEstimate
from fsw.estimate.reference import forget_joint
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.transforms import angle_between, gravity_direction
from fsw.messages import Flags
from fsw.motion.preload import PreloadState
from fsw.state import SequenceStep, State


class ModeEvent(IntEnum):
    """Events that can change the mode."""

    UNSTOW = 0
    MOVE_FREE = 1
    MOVE_GUARDED = 2
    MOVE_BACK = 3
    DONE = 4
    FAULT = 5
    CLEAR = 6
    CLEAR_STOWED = 7
    """Cleared in the stowed pose."""
    CLEAR_TOUCHING = 8
    """Cleared where the arm touches or may touch."""
    STOP = 9
    """A stop was commanded; a guarded or retracting arm may still touch."""
    STOP_STOWED = 10
    """A stop was commanded before the arm had left the stowed pose."""
    DONE_STOWED = 11
    """A move ended in the stowed pose."""
    PRESS = 12
    DONE_RELEASED = 13
    """A tool no longer presses; it still touches."""
    CLEAR_PRESSED = 14
    """Cleared where a tool may press."""
    PLAN = 15
    """A command begins to be planned. After that the mode is again that in which the arm rests."""


TRANSITIONS: Final[dict[tuple[Mode, ModeEvent], Mode]] = {
    (Mode.STOWED, ModeEvent.UNSTOW): Mode.FREE_SPACE,
    (Mode.DEPLOYED, ModeEvent.MOVE_FREE): Mode.FREE_SPACE,
    (Mode.DEPLOYED, ModeEvent.MOVE_GUARDED): Mode.GUARDED,
    (Mode.DEPLOYED, ModeEvent.MOVE_BACK): Mode.RETRACTING,
    (Mode.GUARDED, ModeEvent.MOVE_GUARDED): Mode.GUARDED,
    (Mode.GUARDED, ModeEvent.MOVE_BACK): Mode.RETRACTING,
    (Mode.FREE_SPACE, ModeEvent.DONE): Mode.DEPLOYED,
    (Mode.GUARDED, ModeEvent.DONE): Mode.GUARDED,
    (Mode.RETRACTING, ModeEvent.DONE): Mode.DEPLOYED,
    (Mode.FAULTED, ModeEvent.CLEAR): Mode.DEPLOYED,
    (Mode.FAULTED, ModeEvent.CLEAR_STOWED): Mode.STOWED,
    (Mode.FAULTED, ModeEvent.CLEAR_TOUCHING): Mode.GUARDED,
    (Mode.FREE_SPACE, ModeEvent.STOP): Mode.DEPLOYED,
    (Mode.FREE_SPACE, ModeEvent.STOP_STOWED): Mode.STOWED,
    (Mode.GUARDED, ModeEvent.STOP): Mode.GUARDED,
    (Mode.RETRACTING, ModeEvent.STOP): Mode.GUARDED,
    (Mode.FREE_SPACE, ModeEvent.DONE_STOWED): Mode.STOWED,
    (Mode.GUARDED, ModeEvent.PRESS): Mode.PRELOAD,
    (Mode.PRELOAD, ModeEvent.PRESS): Mode.PRELOAD,
    (Mode.PRELOAD, ModeEvent.DONE): Mode.PRELOAD,
    (Mode.PRELOAD, ModeEvent.DONE_RELEASED): Mode.GUARDED,
    (Mode.PRELOAD, ModeEvent.STOP): Mode.PRELOAD,
    (Mode.FAULTED, ModeEvent.CLEAR_PRESSED): Mode.PRELOAD,
    **{
        (mode, ModeEvent.PLAN): Mode.PLANNING
        for mode in (Mode.STOWED, Mode.DEPLOYED, Mode.GUARDED, Mode.PRELOAD)
    },
    **{(mode, ModeEvent.FAULT): Mode.FAULTED for mode in Mode},
}
"""Next mode by mode and event; a pair that is not here is refused."""

EVENT_OF: Final[dict[type[Command], ModeEvent]] = {
    Unstow: ModeEvent.UNSTOW,
    Stow: ModeEvent.MOVE_FREE,
    MoveJoint: ModeEvent.MOVE_FREE,
    MoveJoints: ModeEvent.MOVE_FREE,
    MoveTool: ModeEvent.MOVE_FREE,
    GuardedMove: ModeEvent.MOVE_GUARDED,
    Retract: ModeEvent.MOVE_BACK,
    PlaceTool: ModeEvent.MOVE_FREE,
    ToolChange: ModeEvent.MOVE_BACK,
    MoveTeachPoint: ModeEvent.MOVE_FREE,
    Dock: ModeEvent.MOVE_GUARDED,
    Process: ModeEvent.MOVE_FREE,
}
"""Event with which the move of a command begins."""


def next_mode(mode: Mode, event: ModeEvent) -> Mode | None:
    """Return the next mode, or None if the event is not allowed in this mode."""
    return TRANSITIONS.get((mode, event))


def stop_event(config: Config, mode: Mode, joints: JointEstimate) -> ModeEvent:
    """Return the event of a stop; an arm that has not left the stowed pose stays stowed."""
    still_stowed = mode is Mode.FREE_SPACE and is_stowed(config, joints)
    return ModeEvent.STOP_STOWED if still_stowed else ModeEvent.STOP


def is_stowed(config: Config, joints: JointEstimate) -> bool:
    """Return whether every joint is calibrated and at its stowed angle."""
    error_rad = np.abs(joints.motor_rad - config.params.poses.stowed_rad).max()
    return bool(joints.reference.calibrated.all() and error_rad < config.params.motion.stow_tolerance_rad)


@dataclass(frozen=True, slots=True, eq=False)
class CommandContext:
    """State, readings and events; each command returns a new one."""

    state: State
    usable: bool
    """True if the readings of this cycle are usable."""
    closed: Flags
    """Contact switches that are closed, (10,)."""
    evrs: tuple[Evr, ...] = ()


def in_contact(config: Config, context: CommandContext, tool: str) -> bool:
    """Return whether a contact switch of a tool is closed."""
    return any(context.closed[k] for k in config.protection.tool_switches[tool])


def tool_preload(context: CommandContext, tool: str) -> PreloadState | None:
    """Return the preload of a tool; None if another tool presses, or none does."""
    preload = context.state.preload
    return preload if preload is not None and preload.tool == tool else None


def with_events(context: CommandContext, *evrs: Evr) -> CommandContext:
    """Append events to the context."""
    return replace(context, evrs=(*context.evrs, *evrs))


def refuse(context: CommandContext, command: object, reason: str) -> CommandContext:
    """Refuse a command: report the reason and change nothing else."""
    return with_events(context, CommandRefused(command_name(command), reason))


def command_name(command: object) -> str:
    """Return the name under which a command, or what was sent as one, is reported."""
    return type(command).__name__


def check_ready(context: CommandContext) -> str | None:
    """Return the reason that nothing can begin now, or None."""
    if context.state.mode is Mode.FAULTED:
        return "a fault stands; clear it first"
    if context.state.move is not None:
        return f"{context.state.move.plan.command} is under way"
    if context.state.sequence is not None:
        return f"{context.state.sequence.command} is under way"
    if context.state.planning is not None:
        return f"{command_name(context.state.planning.command)} is being planned"
    return None if context.usable else "a reading is unusable"


def check_mode(context: CommandContext, event: ModeEvent) -> str | None:
    """Return the reason that the mode does not allow an event, or None."""
    allowed = next_mode(context.state.mode, event) is not None
    return None if allowed else f"not allowed in mode {context.state.mode.name}"


def check_calibrated(context: CommandContext, command: SequenceStep) -> str | None:
    """Return the reason that a command needs joints to be calibrated first, or None."""
    calibrated = context.state.joints.reference.calibrated
    needed = (command.joint,) if isinstance(command, MoveJoint) else tuple(Joint)
    missing = [Joint(j).name.lower() for j in needed if j in tuple(Joint) and not calibrated[j]]
    if not missing:
        return None
    return f"not calibrated: {', '.join(missing)}; until it is, a joint may only look for its hardstop"


LINK_FRAMES = tuple(frame.name.lower() for frame in Frame if frame is not Frame.TOOL)


def known_names(params: Params) -> Names:
    """Return the names that a command may hold, by the mark of their fields."""
    return {
        NameMark.TOOL: params.tool_names,
        NameMark.FRAME: (ROVER, *LINK_FRAMES, *params.tool_names),
        NameMark.BRANCH: (AUTO, *BRANCHES),
    }


def check_arguments(params: Params, command: Command) -> str | None:
    """Check the arguments of a command, as far as the state does not matter."""
    match command:
        case MoveTool(straight=True, branch=branch) if branch != AUTO:
            return f"a straight move stays on the branch that the arm is on; leave branch {AUTO}"
        case GuardedMove(tool=tool) | PlaceTool(tool=tool) | ToolChange(tool=tool, hover_m=0.0):
            if not params.tool_switches[tool]:
                return f"{tool} has no contact switch to end a guarded move"
            if not isinstance(command, ToolChange) and command.normal_R is not None:
                is_inward = np.dot(command.normal_R, command.approach_R) >= 0
                return "the normal points along the approach, not out of the surface" if is_inward else None
            return None
        case ToolChange(hover_m=hover_m, standoff_m=standoff_m) if hover_m >= standoff_m:
            return f"hover at {hover_m:g} m is not below the standoff, {standoff_m:g} m"
        case _:
            return None


def check_force(params: Params, command: Preload) -> str | None:
    """Return the reason that a force is too large for the arm, or None."""
    max_force_N = params.preload.max_force_N
    if command.force_N <= max_force_N:
        return None
    return f"force {command.force_N:g} N is outside 0 .. {max_force_N:g} N"


ENCODER_ZERO_PARAMS: Final = ("gear_ratio", "encoder_counts_per_turn", "hardstop_rad")
"""Parameters that an encoder zero depends on; if one changes, its joint must be calibrated again."""


def set_tilt(config: Config, context: CommandContext, command: SetTilt) -> CommandContext:
    """Set the direction of gravity from the attitude of the rover; refuse one that the IMU contradicts."""
    problem = check_ready(context)
    if problem is not None:
        return refuse(context, command, problem)
    tilted = tilt_joints(config, context.state.joints, command)
    if isinstance(tilted, str):
        return refuse(context, command, tilted)
    joints, difference_rad = tilted
    state = replace(context.state, joints=joints)
    return _complete(replace(context, state=state), command, TiltSet(difference_rad))


def tilt_joints(config: Config, joints: JointEstimate, command: SetTilt) -> tuple[JointEstimate, float] | str:
    """Return the estimate with gravity from an attitude, its angle [rad] to that of the IMU; or a refusal."""
    down_R, bound = gravity_direction(command.roll_rad, command.pitch_rad), config.params.monitors.tilt_rad
    difference_rad = angle_between(joints.imu_R_m_s2 / np.linalg.norm(joints.imu_R_m_s2), down_R)
    if difference_rad > bound:
        return f"the IMU reads gravity {difference_rad:.4f} rad from there, at most {bound:.4f} are allowed"
    return replace(joints, down_R=down_R), difference_rad


def set_param(config: Config, context: CommandContext, command: SetParam) -> CommandContext:
    """Set one parameter, and forget an encoder zero that depends on it."""
    problem = check_ready(context)
    if problem is not None:
        return refuse(context, command, problem)
    changed = replace_param(config.params, command)
    if isinstance(changed, str):
        return refuse(context, command, changed)
    changed_config = configure_at(configure(changed), config.structure_C)
    state = replace(context.state, changed_config=changed_config)
    group, *middle, leaf = command.name.split(".")
    if group == "joints" and leaf in ENCODER_ZERO_PARAMS:
        joint = Joint[middle[0].upper()]
        reference = forget_joint(state.joints.reference, joint)
        state = replace(state, joints=replace(state.joints, reference=reference))
    evr = ParamSet(command.name, command.value, changed_config.params_sha256)
    return _complete(replace(context, state=state), command, evr)


def replace_param(params: Params, command: SetParam) -> Params | str:
    """Return the parameters with one of them replaced, or the reason that this is not valid."""
    changed = _replace_field(params, command.name.split("."), command)
    if isinstance(changed, str):
        return changed
    return next(iter((*check_limits(changed), *check_arm(changed))), changed)


def _complete(context: CommandContext, command: Command, evr: Evr) -> CommandContext:
    return with_events(
        context, CommandAccepted(command_name(command)), evr, CommandCompleted(command_name(command))
    )


def _replace_field(record: Any, names: list[str], command: SetParam) -> Params | str:
    """Return a record with the number under these names replaced, or the reason that it cannot be."""
    name, *rest = names
    field_names = [field.name for field in fields(record)]
    if name not in field_names:
        return f"{command.name}: {name!r} is not a parameter; there are {', '.join(field_names)}"
    value = getattr(record, name)
    if rest and is_dataclass(value):
        inner = _replace_field(value, rest, command)
        return inner if isinstance(inner, str) else replace(record, **{name: inner})
    if rest or not isinstance(value, int | float):
        return f"{command.name}: not one number; only single numbers can be set"
    if isinstance(value, int) and not command.value.is_integer():
        return f"{command.name}: must be a whole number, is {command.value}"
    number = int(command.value) if isinstance(value, int) else command.value
    changed: Params = replace(record, **{name: number})
    return changed
