"""Checks of the arguments of commands that do not depend on the state of the arm."""

from math import isfinite
from typing import assert_never, get_args

import numpy as np

from fsw.dictionary.commands import (
    ROVER,
    BacklashMode,
    Calibrate,
    CalibrateAll,
    ClearFault,
    Command,
    DeflectionMode,
    Dock,
    GuardedMove,
    JointDeflectionMode,
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
    Stop,
    Stow,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import Vector3
from fsw.kinematics.branches import BRANCHES
from fsw.motion.plan_tool import AUTO

MAX_POSITION_M = 1e6
MAX_ATTITUDE_RAD = 1.6

LINK_FRAMES = tuple(frame.name for frame in Frame if frame is not Frame.TOOL)
MAX_LENGTH_M = 1.0
MAX_DURATION_S = 3600.0


def check_arguments(params: Params, command: Command) -> str | None:
    """Check the arguments of a command, as far as the state does not matter.

    Returns:
        The first problem as a sentence, or None.
    """
    no_tool = _check_tool(params, command.tool) if hasattr(command, "tool") else None
    if no_tool is not None:
        return no_tool
    match command:
        case CalibrateAll() | Unstow() | Stow() | SetTilt() | SetParam() | Stop() | ClearFault():
            return None
        case Calibrate(joint=joint):
            return _check_joint(joint)
        case MoveJoint(joint=joint, angle_rad=angle):
            finite = None if isfinite(angle) else "the joint angle is not finite"
            return finite or _check_joint(joint) or _check_backlash(command.backlash)
        case MoveJoints(angle_rad=angles):
            finite = None if np.all(np.isfinite(angles)) else "a joint angle is not finite"
            return finite or _check_compensation(command)
        case MoveTool():
            return _check_move_tool(params, command)
        case GuardedMove():
            problem = _check_switch(params, command.tool) or _check_target(
                command.end_p_RoTo_R_m, command.approach_R
            )
            problem = problem or _check_normal(command)
            return problem or _check_compensation(command)
        case PlaceTool():
            problem = _check_switch(params, command.tool) or _check_target(
                command.p_RoTo_R_m, command.approach_R
            )
            problem = problem or _check_normal(command)
            problem = problem or _check_lengths(command) or _check_compensation(command)
            return problem or _check_branch_name(command.branch)
        case ToolChange():
            problem = _check_switch(params, command.tool) if command.hover_m == 0 else None
            if not 0 <= command.hover_m < command.standoff_m:
                problem = problem or f"hover_m {command.hover_m} m is not below the standoff, nor 0"
            problem = problem or _check_lengths(command) or _check_compensation(command)
            return problem or _check_branch_name(command.branch)
        case MoveTeachPoint():
            return _check_length("standoff_m", command.standoff_m, least_m=0.0) or _check_compensation(
                command
            )
        case Dock():
            problem = _check_length("overtravel_m", command.overtravel_m)
            return problem or _check_backlash(command.backlash)
        case Preload():
            return None if isfinite(command.force_N) else "the force is not finite"
        case Process():
            if not 0 <= command.duration_s <= MAX_DURATION_S:
                return f"duration_s {command.duration_s} s is outside 0 .. {MAX_DURATION_S:g} s"
            return check_vector("gravity_T", command.gravity_T) or _check_compensation(command)
        case Retract(distance_m=d):
            return _check_length("distance_m", d) or _check_compensation(command)
        case _:
            assert_never(command)


def check_bounds(params: Params, command: Preload | SetTilt) -> str | None:
    """Check a force against the parameters, or a tilt against the greatest attitude.

    Returns:
        The problem as a sentence, or None.
    """
    match command:
        case Preload(force_N=force):
            max_force_N = params.preload.max_force_N
            inside, problem = (
                0 <= force <= max_force_N,
                f"force {force:g} N is outside 0 .. {max_force_N:g} N",
            )
        case SetTilt():
            angles = (command.roll_rad, command.pitch_rad)
            inside = all(abs(angle) <= MAX_ATTITUDE_RAD for angle in angles)
            problem = f"roll and pitch must be within {MAX_ATTITUDE_RAD} rad"
    return None if inside else problem


def _check_move_tool(params: Params, command: MoveTool) -> str | None:
    frames = (ROVER, *LINK_FRAMES, *params.tool_names)
    if command.frame not in frames:
        return f"frame {command.frame!r} is not known; there are {', '.join(frames)}"
    if command.straight and command.branch != AUTO:
        return f"a straight move stays on the branch that the arm is on; leave branch {AUTO}"
    problem = _check_branch_name(command.branch) or _check_length("line_m", command.line_m, least_m=0.0)
    problem = problem or _check_target(command.p_FoTo_F_m, command.approach_F)
    return problem or _check_compensation(command)


def _check_switch(params: Params, tool: str) -> str | None:
    return None if params.tool_switches[tool] else f"{tool} has no contact switch to end a guarded move"


def _check_lengths(command: PlaceTool | ToolChange) -> str | None:
    standoff = _check_length("standoff_m", command.standoff_m)
    return standoff or _check_length("overtravel_m", command.overtravel_m)


def _check_length(name: str, length_m: float, least_m: float | None = None) -> str | None:
    """Check that a length is at most a metre, and at least `least_m`; without that, more than 0."""
    enough = length_m > 0 if least_m is None else length_m >= least_m
    if enough and length_m <= MAX_LENGTH_M:
        return None
    least = "more than 0" if least_m is None else f"at least {least_m:g}"
    return f"{name} {length_m} m must be {least} and at most {MAX_LENGTH_M:g} m"


def _check_branch_name(branch: str) -> str | None:
    if branch in (AUTO, *BRANCHES):
        return None
    return f"branch {branch!r} is not known; there are {AUTO}, {', '.join(BRANCHES)}"


def _check_joint(joint: object) -> str | None:
    if isinstance(joint, int) and joint in tuple(Joint):
        return None
    return f"joint {joint!r} is not known; there are {', '.join(joint.name.lower() for joint in Joint)}"


def _check_tool(params: Params, tool: object) -> str | None:
    if tool in params.tool_names:
        return None
    return f"tool {tool!r} is not known; there are {', '.join(params.tool_names)}"


def _check_target(p_m: Vector3, approach: Vector3) -> str | None:
    if not (np.all(np.isfinite(p_m)) and np.all(np.isfinite(approach))):
        return "position or approach is not finite"
    if max(map(abs, p_m)) > MAX_POSITION_M:
        return f"the position is farther than {MAX_POSITION_M:g} m away"
    return check_vector("the approach", approach)


def _check_normal(command: GuardedMove | PlaceTool) -> str | None:
    if command.normal_R is None:
        return None
    problem = check_vector("normal_R", command.normal_R)
    if problem is None and np.dot(command.normal_R, command.approach_R) >= 0:
        return "normal_R points along the approach, not out of the surface"
    return problem


def check_vector(name: str, direction: Vector3) -> str | None:
    """Check that a direction is finite and has a length.

    Returns:
        The problem as a sentence that begins with the name, or None.
    """
    if not np.all(np.isfinite(direction)):
        return f"{name} is not finite"
    return None if 1e-9 < max(map(abs, direction)) < 1e9 else f"{name} has no length"


def _check_compensation(
    command: MoveJoints
    | MoveTool
    | GuardedMove
    | PlaceTool
    | ToolChange
    | MoveTeachPoint
    | Process
    | Retract,
) -> str | None:
    known = get_args(JointDeflectionMode if isinstance(command, MoveJoints | Process) else DeflectionMode)
    if command.deflection in known:
        return _check_backlash(command.backlash)
    return f"deflection {command.deflection!r} is not known; there are {', '.join(known)}"


def _check_backlash(backlash: str) -> str | None:
    if backlash in get_args(BacklashMode):
        return None
    return f"backlash {backlash!r} is not known; there are {', '.join(get_args(BacklashMode))}"
