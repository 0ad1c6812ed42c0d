"""What commands act on, and the refusals that many of them share."""

from dataclasses import dataclass, replace

from fsw.dictionary.commands import MoveJoint
from fsw.dictionary.enums import TOOL_SWITCHES, Joint, Mode, Tool
from fsw.dictionary.evrs import CommandRefused, Evr
from fsw.executive.modes import Event, after
from fsw.messages import Flags
from fsw.motion.plan_press import Pressing
from fsw.state import State, Step


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """What commands act on; each returns it changed."""

    state: State
    usable: bool
    """Whether this cycle's readings are."""
    closed: Flags
    """Which contact switches are."""
    evrs: tuple[Evr, ...] = ()


def touches(now: Situation, tool: Tool) -> bool:
    """Whether a contact switch of a tool is closed."""
    return any(now.closed[switch] for switch in TOOL_SWITCHES[tool])


def pressing_of(now: Situation, tool: Tool) -> Pressing | None:
    """What a tool presses with; None where another tool presses, or none does."""
    pressing = now.state.pressing
    return pressing if pressing is not None and pressing.tool is tool else None


def told(now: Situation, *evrs: Evr) -> Situation:
    """The situation with more to report."""
    return replace(now, evrs=(*now.evrs, *evrs))


def refused(now: Situation, command: Step, reason: str) -> Situation:
    """Nothing is changed, and the reason is said."""
    return told(now, CommandRefused(name_of(command), reason))


def name_of(command: Step) -> str:
    """The name under which a command is reported."""
    return type(command).__name__


def not_now(now: Situation) -> str | None:
    """Why nothing can begin in this situation."""
    if now.state.mode is Mode.FAULTED:
        return "a fault stands; clear it first"
    if now.state.move is not None:
        return f"{now.state.move.command} is under way"
    if now.state.sequence is not None:
        return f"{now.state.sequence.command} is under way"
    return None if now.usable else "a reading is unusable"


def not_in_mode(now: Situation, event: Event) -> str | None:
    """Why a move of this kind can not begin in this mode."""
    allowed = after(now.state.mode, event) is not None
    return None if allowed else f"not allowed in mode {now.state.mode.name}"


def not_calibrated(now: Situation, command: Step) -> str | None:
    """Why this command must wait until joints are calibrated."""
    known = now.state.joints.reference.calibrated
    needed = (command.joint,) if isinstance(command, MoveJoint) else tuple(Joint)
    missing = [Joint(joint).name.lower() for joint in needed if joint in tuple(Joint) and not known[joint]]
    if not missing:
        return None
    return f"not calibrated: {', '.join(missing)}; until it is, a joint may only look for its hardstop"
