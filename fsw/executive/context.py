"""Context in which a command is handled, and the checks that many commands share."""

from dataclasses import dataclass, replace

from fsw.config import Config
from fsw.dictionary.commands import MoveJoint
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandRefused, Evr
from fsw.executive.modes import ModeEvent, next_mode
from fsw.messages import Flags
from fsw.motion.preload import PreloadState
from fsw.state import SequenceStep, State


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
        return f"{context.state.move.command} is under way"
    if context.state.sequence is not None:
        return f"{context.state.sequence.command} is under way"
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
