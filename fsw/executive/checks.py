"""Checks of the arguments of commands against the parameters, and against each other.

The types and limits of single arguments are checked where a command arrives (dictionary/arguments.py).
"""

import numpy as np

from fsw.dictionary.arguments import Names
from fsw.dictionary.commands import (
    AUTO,
    ROVER,
    Command,
    GuardedMove,
    MoveTool,
    PlaceTool,
    Preload,
    ToolChange,
)
from fsw.dictionary.enums import Frame
from fsw.dictionary.params import Params
from fsw.dictionary.types import NameMark
from fsw.kinematics.branches import BRANCHES

LINK_FRAMES = tuple(frame.name.lower() for frame in Frame if frame is not Frame.TOOL)


def known_names(params: Params) -> Names:
    """Return the names that a command may hold, by the mark of their fields."""
    return {
        NameMark.TOOL: params.tool_names,
        NameMark.FRAME: (ROVER, *LINK_FRAMES, *params.tool_names),
        NameMark.BRANCH: (AUTO, *BRANCHES),
    }


def check_arguments(params: Params, command: Command) -> str | None:
    """Check the arguments of a command, as far as the state does not matter.

    Returns:
        The first problem as a sentence, or None.
    """
    match command:
        case MoveTool(straight=True, branch=branch) if branch != AUTO:
            return f"a straight move stays on the branch that the arm is on; leave branch {AUTO}"
        case GuardedMove(tool=tool) | PlaceTool(tool=tool) | ToolChange(tool=tool, hover_m=0.0):
            if not params.tool_switches[tool]:
                return f"{tool} has no contact switch to end a guarded move"
            return None if isinstance(command, ToolChange) else _check_normal(command)
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


def _check_normal(command: GuardedMove | PlaceTool) -> str | None:
    if command.normal_R is None or np.dot(command.normal_R, command.approach_R) < 0:
        return None
    return "the normal points along the approach, not out of the surface"
