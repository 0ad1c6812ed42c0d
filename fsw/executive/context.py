"""What commands act on, and the refusals that many of them share."""

from dataclasses import dataclass, replace

from fsw.dictionary.commands import MoveJoint
from fsw.dictionary.enums import TOOL_SWITCHES, Joint, Mode, Tool
from fsw.dictionary.evrs import CommandRefused, Evr
from fsw.executive.modes import ModeEvent, next_mode
from fsw.messages import Flags
from fsw.motion.preload import PreloadState
from fsw.state import SequenceStep, State


@dataclass(frozen=True, slots=True, eq=False)
class CommandContext:
    """What commands act on; each returns it changed."""

    state: State
    usable: bool
    """Whether this cycle's readings are."""
    closed: Flags
    """Which contact switches are."""
    evrs: tuple[Evr, ...] = ()


def in_contact(context: CommandContext, tool: Tool) -> bool:
    """Whether a contact switch of a tool is closed."""
    return any(context.closed[switch] for switch in TOOL_SWITCHES[tool])


def tool_preload(context: CommandContext, tool: Tool) -> PreloadState | None:
    """What a tool presses with; None where another tool presses, or none does."""
    preload = context.state.preload
    return preload if preload is not None and preload.tool is tool else None


def with_events(context: CommandContext, *evrs: Evr) -> CommandContext:
    """The situation with more to report."""
    return replace(context, evrs=(*context.evrs, *evrs))


def refuse(context: CommandContext, command: SequenceStep, reason: str) -> CommandContext:
    """Nothing is changed, and the reason is said."""
    return with_events(context, CommandRefused(command_name(command), reason))


def command_name(command: SequenceStep) -> str:
    """The name under which a command is reported."""
    return type(command).__name__


def check_ready(context: CommandContext) -> str | None:
    """Why nothing can begin in this situation."""
    if context.state.mode is Mode.FAULTED:
        return "a fault stands; clear it first"
    if context.state.move is not None:
        return f"{context.state.move.command} is under way"
    if context.state.sequence is not None:
        return f"{context.state.sequence.command} is under way"
    return None if context.usable else "a reading is unusable"


def check_mode(context: CommandContext, event: ModeEvent) -> str | None:
    """Why a move of this kind can not begin in this mode."""
    allowed = next_mode(context.state.mode, event) is not None
    return None if allowed else f"not allowed in mode {context.state.mode.name}"


def check_calibrated(context: CommandContext, command: SequenceStep) -> str | None:
    """Why this command must wait until joints are calibrated."""
    known = context.state.joints.reference.calibrated
    needed = (command.joint,) if isinstance(command, MoveJoint) else tuple(Joint)
    missing = [Joint(joint).name.lower() for joint in needed if joint in tuple(Joint) and not known[joint]]
    if not missing:
        return None
    return f"not calibrated: {', '.join(missing)}; until it is, a joint may only look for its hardstop"
