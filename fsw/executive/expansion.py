"""Command expansion: the single moves that a compound command consists of."""

from typing import Final, assert_never

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import (
    Calibrate,
    DeflectionMode,
    Dock,
    GuardedMove,
    MoveJoint,
    MoveJoints,
    MoveTeachPoint,
    MoveTool,
    PlaceTool,
    Process,
    Retract,
    ToolChange,
)
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint, Tool
from fsw.dictionary.params import Params, TeachPoint
from fsw.dictionary.types import joints5, vector3
from fsw.estimate.joints import JointEstimate
from fsw.executive.homing_poses import HOMED_TWICE
from fsw.kinematics.transforms import Array, normalize
from fsw.motion.compensation import Compensation
from fsw.motion.plan import Refusal
from fsw.motion.plan_process import find_gravity_pose
from fsw.motion.plan_tool import Line, start_line
from fsw.state import Hold, Sequence, SequenceStep

CompoundCommand = PlaceTool | ToolChange | MoveTeachPoint | Dock | Process


def expand_command(
    config: Config, joints: JointEstimate, tool: Tool, command: CompoundCommand
) -> tuple[SequenceStep, ...] | Refusal:
    """The moves of a command from where the joints are; `tool` is that of the last tool command."""
    match command:
        case PlaceTool():
            return _expand_place(config, joints, tool, command)
        case ToolChange():
            return _expand_tool_change(config, joints, tool, command)
        case MoveTeachPoint():
            return _expand_teach_point(config, joints, command)
        case Dock():
            return _expand_dock(config, command)
        case Process():
            pose = find_gravity_pose(config, joints, command)
            if isinstance(pose, Refusal):
                return pose
            turn = MoveJoints(joints5(pose), command.backlash, command.deflection)
            return turn, Hold(command.duration_s, command.vibrate)
        case _:
            assert_never(command)


def find_teach_point(config: Config, name: str) -> TeachPoint | Refusal:
    """The taught point of this name."""
    points = {point.name: point for point in config.params.teach}
    if name in points:
        return points[name]
    return Refusal(f"point {name!r} was not taught; there are {', '.join(points) or 'none'}")


def teach_point_tool(point: TeachPoint) -> Tool:
    """The tool of a taught point."""
    return Tool[point.tool.upper()]


def locate_spot(config: Config, joints: JointEstimate, touching: Tool, command: ToolChange) -> Line:
    """Where a tool change takes the touching tool to be: a line that has yet to go anywhere."""
    deflection: DeflectionMode = "off" if command.deflection == "off" else "absolute"
    return start_line(config, joints, touching, Compensation(command.backlash, deflection))


def _expand_place(
    config: Config, joints: JointEstimate, tool: Tool, command: PlaceTool
) -> tuple[SequenceStep, ...]:
    """Relative compensation counts from where the arm is now, for both moves: they aim at one place."""
    compensation = Compensation(command.backlash, command.deflection)
    p, approach = compensation.target(
        config, joints, tool, np.array(command.p_RoTo_R_m), normalize(np.array(command.approach_R))
    )
    deflection: DeflectionMode = "off" if command.deflection == "off" else "absolute"
    end = vector3(p + command.overtravel_m * approach)
    touch = GuardedMove(command.tool, end, vector3(approach), command.backlash, deflection)
    return _standoff_move(command, p, approach, command.overtravel_m, deflection), touch


def _expand_tool_change(
    config: Config, joints: JointEstimate, touching: Tool, command: ToolChange
) -> tuple[SequenceStep, ...]:
    """Back off, and place the other tool where this one is believed to touch.

    The believed place carries the error of the model at this pose, so that at the next pose only the
    difference of errors is left: relative compensation follows from counting from here. The moves themselves
    are compensated absolutely, or not at all.
    """
    here = locate_spot(config, joints, touching, command)
    deflection = here.compensation.deflection
    beyond_m = -command.hover_m if command.hover_m > 0 else command.overtravel_m
    end, approach = vector3(here.p_m + beyond_m * here.axis), vector3(here.axis)
    back = Retract(touching, command.standoff_m, command.backlash, deflection)
    to_standoff = _standoff_move(command, here.p_m, here.axis, beyond_m, deflection)
    last: SequenceStep = GuardedMove(command.tool, end, approach, command.backlash, deflection)
    if command.hover_m > 0:
        last = MoveTool(
            command.tool, end, approach, straight=True, backlash=command.backlash, deflection=deflection
        )
    return back, to_standoff, last


def _standoff_move(
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


def _expand_teach_point(
    config: Config, joints: JointEstimate, command: MoveTeachPoint
) -> tuple[SequenceStep, ...] | Refusal:
    point = find_teach_point(config, command.point)
    if isinstance(point, Refusal):
        return point
    gravity = joints.gravity_R_m_s2
    approach = normalize(gravity if command.along_gravity else np.array(point.approach_R))
    p = np.array(point.p_RoTo_R_m) - command.away_m * approach
    move = MoveTool(
        teach_point_tool(point),
        vector3(p),
        vector3(approach),
        straight=command.straight,
        line_m=0.0 if command.straight else command.away_m,
        backlash=command.backlash,
        deflection=command.deflection,
        branch="AUTO" if command.straight else point.branch,
    )
    return (move,)


def _expand_dock(config: Config, command: Dock) -> tuple[SequenceStep, ...] | Refusal:
    point = find_teach_point(config, command.point)
    if isinstance(point, Refusal):
        return point
    approach = normalize(np.array(point.approach_R))
    end = np.array(point.p_RoTo_R_m) + command.overtravel_m * approach
    return (GuardedMove(teach_point_tool(point), vector3(end), vector3(approach), command.backlash),)


UNPARK_ORDER: Final = (Joint.AZIMUTH, Joint.TURRET, Joint.WRIST, Joint.ELBOW, Joint.ELEVATION)
"""In which the joints go from their parking places to the last turn: sideways first, down last."""


def expand_calibrate_all(params: Params, anew: bool = False) -> Sequence:
    """Each joint to its hardstop and then to where it waits for the others; one of them again at the end."""
    park, again = params.hardstop.park_rad, params.hardstop.again_rad
    turns = [(Calibrate(joint, anew), MoveJoint(joint, park[joint])) for joint in HARDSTOP_ORDER]
    ready = [MoveJoint(joint, again[joint]) for joint in UNPARK_ORDER if again[joint] != park[joint]]
    last = (Calibrate(HOMED_TWICE, anew), MoveJoint(HOMED_TWICE, park[HOMED_TWICE]))
    return Sequence("CalibrateAll", (*(command for turn in turns for command in turn), *ready, *last))
