"""Command expansion: the single moves of a compound command, and the points that they start from."""

from typing import Final, assert_never

import numpy as np

from fsw.collision.geometry import TargetSurface
from fsw.config import Config
from fsw.dictionary.commands import (
    Calibrate,
    DeflectionMode,
    Dock,
    GuardedMove,
    MoveJoint,
    MoveTeachPoint,
    MoveTool,
    PlaceTool,
    Process,
    Retract,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.params import Params, TeachPoint
from fsw.dictionary.types import AUTO, vector3
from fsw.estimate.joints import JointEstimate
from fsw.executive.poses import HOMED_TWICE
from fsw.kinematics.transforms import Array, normalize
from fsw.motion.plan import Compensation, Refusal
from fsw.motion.plan_tool import Line, start_line
from fsw.state import Sequence, SequenceStep

ExpandedCommand = PlaceTool | ToolChange | MoveTeachPoint | Dock
CompoundCommand = ExpandedCommand | Process

UNPARK_ORDER: Final = (Joint.AZIMUTH, Joint.TURRET, Joint.WRIST, Joint.ELBOW, Joint.ELEVATION)
"""Order in which the joints leave their parking angles for the second homing: sideways first, down last."""


def expand_command(
    config: Config,
    joints: JointEstimate,
    tool: str,
    command: ExpandedCommand,
    surface: TargetSurface | None = None,
    farther_m: float = 0.0,
) -> tuple[SequenceStep, ...] | Refusal:
    """Expand a compound command into single moves from the present joint angles.

    The move of a process follows from a search of its pose (`planning.py`).

    Args:
        surface: Surface of `locate_surface`; None if there is none.
        farther_m: Distance from the standoff to a way point farther from the surface; 0 for none.
    """
    match command:
        case PlaceTool():
            return _expand_place(config, joints, tool, command, farther_m)
        case ToolChange():
            return _expand_tool_change(config, joints, tool, command, surface, farther_m)
        case MoveTeachPoint():
            return _expand_teach_point(config, joints, command)
        case Dock():
            return _expand_dock(config, command)
        case _:
            assert_never(command)


def find_teach_point(config: Config, name: str) -> TeachPoint | Refusal:
    """Return the taught point of this name, or refuse."""
    points = {point.name: point for point in config.params.teach}
    if name in points:
        return points[name]
    return Refusal(f"point {name!r} was not taught; there are {', '.join(points) or 'none'}")


def locate_spot(config: Config, joints: JointEstimate, touching: str, command: ToolChange) -> Line:
    """Estimate the contact point of a tool for a tool change: a line along its axis, of no length."""
    deflection: DeflectionMode = "off" if command.deflection == "off" else "absolute"
    return start_line(config, joints, touching, Compensation(command.backlash, deflection))


def _expand_place(
    config: Config, joints: JointEstimate, tool: str, command: PlaceTool, farther_m: float
) -> tuple[SequenceStep, ...]:
    """Expand a placement into moves to the standoff and a guarded move.

    Relative compensation refers to the present deflection for both moves, so both have the same target.
    """
    p, approach = _locate_target(config, joints, tool, command)
    deflection: DeflectionMode = "off" if command.deflection == "off" else "absolute"
    end = vector3(p + command.overtravel_m * approach)
    touch = GuardedMove(command.tool, end, vector3(approach), command.backlash, deflection, command.normal_R)
    return *_standoff_moves(command, p, approach, command.overtravel_m, deflection, farther_m), touch


def _locate_target(
    config: Config, joints: JointEstimate, tool: str, command: PlaceTool
) -> tuple[Array, Array]:
    """Return the target and the approach of a placement, with relative compensation added."""
    compensation = Compensation(command.backlash, command.deflection)
    return compensation.target(
        config, joints, tool, np.array(command.p_RoTo_R_m), normalize(np.array(command.approach_R))
    )


def locate_surface(
    config: Config, joints: JointEstimate, tool: str, command: SequenceStep, known: TargetSurface | None
) -> TargetSurface | None:
    """Return the surface that a command is to keep away from: of its target, or else that of the last one."""
    match command:
        case PlaceTool():
            p, approach = _locate_target(config, joints, tool, command)
        case GuardedMove():
            p, approach = np.array(command.end_p_RoTo_R_m), normalize(np.array(command.approach_R))
        case Unstow():
            return None
        case _:
            return known
    normal = -approach if command.normal_R is None else normalize(command.normal_R)
    return TargetSurface(p, normal, config.collision_geometry.surface_radius_m)


def locate_touched_surface(
    config: Config, joints: JointEstimate, touching: str, known: TargetSurface | None
) -> TargetSurface:
    """Return the surface through the tip of a touching tool, with the normal of the known one."""
    contact = start_line(config, joints, touching, Compensation())
    normal = -contact.axis if known is None else known.normal_R
    return TargetSurface(contact.p_m, normal, config.collision_geometry.surface_radius_m)


def _expand_tool_change(
    config: Config,
    joints: JointEstimate,
    touching: str,
    command: ToolChange,
    surface: TargetSurface | None,
    farther_m: float,
) -> tuple[SequenceStep, ...]:
    """Expand a tool change: retract, and place the other tool at the estimated contact point of this one.

    The estimated point contains the model error at this pose, so only the difference of two model errors
    remains at the next pose. This is relative compensation. The moves themselves are compensated absolutely,
    or not at all.
    """
    contact = locate_spot(config, joints, touching, command)
    deflection = contact.compensation.deflection
    beyond_m = -command.hover_m if command.hover_m > 0 else command.overtravel_m
    end, approach = vector3(contact.p_m + beyond_m * contact.axis), vector3(contact.axis)
    back = Retract(touching, command.standoff_m + farther_m, command.backlash, deflection)
    to_standoff = _standoff_moves(command, contact.p_m, contact.axis, beyond_m, deflection, farther_m)
    normal = None if surface is None else vector3(surface.normal_R)
    last: SequenceStep = GuardedMove(command.tool, end, approach, command.backlash, deflection, normal)
    if command.hover_m > 0:
        last = MoveTool(
            command.tool, end, approach, straight=True, backlash=command.backlash, deflection=deflection
        )
    return back, *to_standoff, last


def _standoff_moves(
    command: PlaceTool | ToolChange,
    p_m: Array,
    approach: Array,
    beyond_m: float,
    deflection: DeflectionMode,
    farther_m: float,
) -> tuple[MoveTool, ...]:
    """Build the moves to the standoff, from where a straight line to `beyond_m` past the target fits."""
    return tuple(
        MoveTool(
            command.tool,
            vector3(p_m - distance_m * approach),
            vector3(approach),
            line_m=distance_m + beyond_m,
            backlash=command.backlash,
            deflection=deflection,
            branch=command.branch,
        )
        for distance_m in dict.fromkeys((command.standoff_m + farther_m, command.standoff_m))
    )


def _expand_teach_point(
    config: Config, joints: JointEstimate, command: MoveTeachPoint
) -> tuple[SequenceStep, ...] | Refusal:
    point = find_teach_point(config, command.point)
    if isinstance(point, Refusal):
        return point
    gravity = joints.gravity_R_m_s2
    approach = normalize(gravity if command.along_gravity else np.array(point.approach_R))
    p = np.array(point.p_RoTo_R_m) - command.standoff_m * approach
    move = MoveTool(
        point.tool,
        vector3(p),
        vector3(approach),
        straight=command.straight,
        line_m=0.0 if command.straight else command.standoff_m,
        backlash=command.backlash,
        deflection=command.deflection,
        branch=AUTO if command.straight else point.branch,
    )
    return (move,)


def _expand_dock(config: Config, command: Dock) -> tuple[SequenceStep, ...] | Refusal:
    point = find_teach_point(config, command.point)
    if isinstance(point, Refusal):
        return point
    approach = normalize(np.array(point.approach_R))
    end = np.array(point.p_RoTo_R_m) + command.overtravel_m * approach
    return (GuardedMove(point.tool, vector3(end), vector3(approach), backlash=command.backlash),)


def expand_calibrate_all(params: Params, accept_moved: bool = False) -> Sequence:
    """Expand the calibration of all joints.

    Each joint runs to its hardstop and then to its parking angle. HOMED_TWICE does so again at the end.
    """
    park, again = params.hardstop.park_rad, params.hardstop.second_start_rad
    homings = [(Calibrate(joint, accept_moved), MoveJoint(joint, park[joint])) for joint in HARDSTOP_ORDER]
    unpark = [MoveJoint(joint, again[joint]) for joint in UNPARK_ORDER if again[joint] != park[joint]]
    last = (Calibrate(HOMED_TWICE, accept_moved), MoveJoint(HOMED_TWICE, park[HOMED_TWICE]))
    return Sequence("CalibrateAll", (*(command for pair in homings for command in pair), *unpark, *last))
