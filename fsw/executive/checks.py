"""What can be wrong with a command's own numbers and words, whatever the arm is doing."""

from typing import get_args

import numpy as np

from fsw.dictionary.commands import (
    Deflection,
    GuardedMove,
    MoveJoints,
    MoveTool,
    Retract,
    Unstow,
    Vector3,
)
from fsw.dictionary.joints import SWITCHES_OF
from fsw.kinematics.branches import BRANCHES
from fsw.motion.plan_tool import AUTO

FARTHEST_M = 1e6

MoveCommand = Unstow | MoveJoints | MoveTool | GuardedMove | Retract


def malformed(command: MoveCommand) -> str | None:
    """What is wrong with the command's own numbers and words."""
    match command:
        case MoveJoints(angle_rad=angle):
            return None if np.all(np.isfinite(angle)) else "a joint angle is not finite"
        case MoveTool():
            if command.branch not in (AUTO, *BRANCHES):
                return f"branch {command.branch!r} is not known; there are {AUTO}, {', '.join(BRANCHES)}"
            if not 0 <= command.line_m <= 1.0:
                return f"line_m {command.line_m} m is outside 0 .. 1 m"
            return _malformed_target(command.p_RoTo_R_m, command.approach_R, command.deflection)
        case GuardedMove():
            if not SWITCHES_OF[command.tool]:
                return f"{command.tool.name} has no contact switch to end a guarded move"
            return _malformed_target(command.end_p_RoTo_R_m, command.approach_R, command.deflection)
        case Retract(distance_m=d):
            if not 0 < d <= 1.0:
                return f"distance {d} m is outside 0 .. 1 m"
            return _malformed_deflection(command.deflection)
    return None


def _malformed_target(p_m: Vector3, approach: Vector3, deflection: str) -> str | None:
    if not (np.all(np.isfinite(p_m)) and np.all(np.isfinite(approach))):
        return "position or approach is not finite"
    if max(map(abs, p_m)) > FARTHEST_M:
        return f"the position is farther than {FARTHEST_M:g} m away"
    if not 1e-9 < max(map(abs, approach)) < 1e9:
        return "the approach has no length"
    return _malformed_deflection(deflection)


def _malformed_deflection(deflection: str) -> str | None:
    known = get_args(Deflection)
    if deflection in known:
        return None
    return f"deflection {deflection!r} is not known; there are {', '.join(known)}"
