"""Mode machine: the table of transitions, the event that begins each command, the event of a stop."""

from enum import IntEnum
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import (
    Command,
    Dock,
    GuardedMove,
    MoveJoint,
    MoveJoints,
    MoveTeachPoint,
    MoveTool,
    PlaceTool,
    Process,
    Retract,
    Stow,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import Mode
from fsw.estimate.joints import JointEstimate


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
