"""What can be wrong with a command's own numbers and words, whatever the arm is doing."""

from math import isfinite
from typing import get_args

import numpy as np

from fsw.dictionary.commands import (
    Backlash,
    Calibrate,
    Deflection,
    GuardedMove,
    MoveJoint,
    MoveJoints,
    MoveTool,
    Retract,
    Unstow,
    Vector3,
)
from fsw.dictionary.joints import SWITCHES_OF, Joint
from fsw.kinematics.branches import BRANCHES
from fsw.motion.plan_tool import AUTO

FARTHEST_M = 1e6

MoveCommand = Calibrate | Unstow | MoveJoint | MoveJoints | MoveTool | GuardedMove | Retract


def malformed(command: MoveCommand) -> str | None:
    """What is wrong with the command's own numbers and words."""
    match command:
        case Calibrate(joint=joint):
            return _malformed_joint(joint)
        case MoveJoint(joint=joint, angle_rad=angle):
            finite = None if isfinite(angle) else "the joint angle is not finite"
            return finite or _malformed_joint(joint) or _malformed_backlash(command.backlash)
        case MoveJoints(angle_rad=angles):
            finite = None if np.all(np.isfinite(angles)) else "a joint angle is not finite"
            return finite or _malformed_backlash(command.backlash)
        case MoveTool():
            if command.branch not in (AUTO, *BRANCHES):
                return f"branch {command.branch!r} is not known; there are {AUTO}, {', '.join(BRANCHES)}"
            if not 0 <= command.line_m <= 1.0:
                return f"line_m {command.line_m} m is outside 0 .. 1 m"
            return _malformed_target(command.p_FoTo_F_m, command.approach_F) or _malformed_modes(command)
        case GuardedMove():
            if not SWITCHES_OF[command.tool]:
                return f"{command.tool.name} has no contact switch to end a guarded move"
            return _malformed_target(command.end_p_RoTo_R_m, command.approach_R) or _malformed_modes(command)
        case Retract(distance_m=d):
            if not 0 < d <= 1.0:
                return f"distance {d} m is outside 0 .. 1 m"
            return _malformed_modes(command)
    return None


def _malformed_joint(joint: object) -> str | None:
    if isinstance(joint, int) and joint in tuple(Joint):
        return None
    return f"joint {joint!r} is not known; there are {', '.join(joint.name.lower() for joint in Joint)}"


def _malformed_target(p_m: Vector3, approach: Vector3) -> str | None:
    if not (np.all(np.isfinite(p_m)) and np.all(np.isfinite(approach))):
        return "position or approach is not finite"
    if max(map(abs, p_m)) > FARTHEST_M:
        return f"the position is farther than {FARTHEST_M:g} m away"
    if not 1e-9 < max(map(abs, approach)) < 1e9:
        return "the approach has no length"
    return None


def _malformed_modes(command: MoveTool | GuardedMove | Retract) -> str | None:
    if command.deflection in get_args(Deflection):
        return _malformed_backlash(command.backlash)
    return f"deflection {command.deflection!r} is not known; there are {', '.join(get_args(Deflection))}"


def _malformed_backlash(backlash: str) -> str | None:
    if backlash in get_args(Backlash):
        return None
    return f"backlash {backlash!r} is not known; there are {', '.join(get_args(Backlash))}"
