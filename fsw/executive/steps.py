"""Commands that take several moves: the moves, each as a command of its own."""

from typing import assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import (
    DeflectionMode,
    Dock,
    GuardedMove,
    MoveJoints,
    MoveTeachPoint,
    MoveTool,
    PlaceTool,
    Process,
    Retract,
    ToolChange,
)
from fsw.dictionary.enums import Tool
from fsw.dictionary.params import TeachPoint
from fsw.dictionary.types import joints5, vector3
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.transforms import Array, normalize
from fsw.motion.compensation import Compensation
from fsw.motion.plan import Refusal
from fsw.motion.plan_line import Line, from_here
from fsw.motion.plan_process import gravity_pose
from fsw.state import Hold, Step

Stepped = PlaceTool | ToolChange | MoveTeachPoint | Dock | Process


def steps_of(
    config: Config, joints: JointEstimate, tool: Tool, command: Stepped
) -> tuple[Step, ...] | Refusal:
    """The moves of a command from where the joints are; `tool` is that of the last tool command."""
    match command:
        case PlaceTool():
            return _place(config, joints, tool, command)
        case ToolChange():
            return _tool_change(config, joints, tool, command)
        case MoveTeachPoint():
            return _to_point(config, joints, command)
        case Dock():
            return _dock(config, command)
        case Process():
            pose = gravity_pose(config, joints, command)
            if isinstance(pose, Refusal):
                return pose
            turn = MoveJoints(joints5(pose), command.backlash, command.deflection)
            return turn, Hold(command.duration_s, command.vibrate)
        case _:
            assert_never(command)


def taught(config: Config, name: str) -> TeachPoint | Refusal:
    """The taught point of this name."""
    points = {point.name: point for point in config.params.teach}
    if name in points:
        return points[name]
    return Refusal(f"point {name!r} was not taught; there are {', '.join(points) or 'none'}")


def tool_of(point: TeachPoint) -> Tool:
    """The tool of a taught point."""
    return Tool[point.tool.upper()]


def spot(config: Config, joints: JointEstimate, touching: Tool, command: ToolChange) -> Line:
    """Where a tool change takes the touching tool to be: a line that has yet to go anywhere."""
    deflection: DeflectionMode = "off" if command.deflection == "off" else "absolute"
    return from_here(config, joints, touching, Compensation(command.backlash, deflection))


def _place(config: Config, joints: JointEstimate, tool: Tool, command: PlaceTool) -> tuple[Step, ...]:
    """Relative compensation counts from where the arm is now, for both moves: they aim at one place."""
    compensation = Compensation(command.backlash, command.deflection)
    p, approach = compensation.target(
        config, joints, tool, np.array(command.p_RoTo_R_m), normalize(np.array(command.approach_R))
    )
    deflection: DeflectionMode = "off" if command.deflection == "off" else "absolute"
    end = vector3(p + command.overtravel_m * approach)
    touch = GuardedMove(command.tool, end, vector3(approach), command.backlash, deflection)
    return _to_standoff(command, p, approach, command.overtravel_m, deflection), touch


def _tool_change(
    config: Config, joints: JointEstimate, touching: Tool, command: ToolChange
) -> tuple[Step, ...]:
    """Back off, and place the other tool where this one is believed to touch.

    The believed place carries the error of the model at this pose, so that at the next pose only the
    difference of errors is left: relative compensation follows from counting from here. The moves themselves
    are compensated absolutely, or not at all.
    """
    here = spot(config, joints, touching, command)
    deflection = here.compensation.deflection
    beyond_m = -command.hover_m if command.hover_m > 0 else command.overtravel_m
    end, approach = vector3(here.p_m + beyond_m * here.axis), vector3(here.axis)
    back = Retract(touching, command.standoff_m, command.backlash, deflection)
    to_standoff = _to_standoff(command, here.p_m, here.axis, beyond_m, deflection)
    last: Step = GuardedMove(command.tool, end, approach, command.backlash, deflection)
    if command.hover_m > 0:
        last = MoveTool(
            command.tool, end, approach, straight=True, backlash=command.backlash, deflection=deflection
        )
    return back, to_standoff, last


def _to_standoff(
    command: PlaceTool | ToolChange, p_m: Array, approach: Array, beyond_m: float, deflection: DeflectionMode
) -> MoveTool:
    """To a standoff in front of a place, from where the tool can go straight on to so far beyond it."""
    return MoveTool(
        command.tool,
        vector3(p_m - command.standoff_m * approach),
        vector3(approach),
        line_m=command.standoff_m + beyond_m,
        backlash=command.backlash,
        deflection=deflection,
        branch=command.branch,
    )


def _to_point(config: Config, joints: JointEstimate, command: MoveTeachPoint) -> tuple[Step, ...] | Refusal:
    point = taught(config, command.point)
    if isinstance(point, Refusal):
        return point
    gravity = joints.gravity_R_m_s2
    approach = normalize(gravity if command.along_gravity else np.array(point.approach_R))
    p = np.array(point.p_RoTo_R_m) - command.away_m * approach
    move = MoveTool(
        tool_of(point),
        vector3(p),
        vector3(approach),
        straight=command.straight,
        line_m=0.0 if command.straight else command.away_m,
        backlash=command.backlash,
        deflection=command.deflection,
        branch="AUTO" if command.straight else point.branch,
    )
    return (move,)


def _dock(config: Config, command: Dock) -> tuple[Step, ...] | Refusal:
    point = taught(config, command.point)
    if isinstance(point, Refusal):
        return point
    approach = normalize(np.array(point.approach_R))
    end = np.array(point.p_RoTo_R_m) + command.overtravel_m * approach
    return (GuardedMove(tool_of(point), vector3(end), vector3(approach), command.backlash),)
