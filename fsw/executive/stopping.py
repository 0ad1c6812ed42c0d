"""Ending what is under way, and going on after a fault."""

from dataclasses import replace

from fsw.config import Config
from fsw.dictionary.commands import ClearFault, Stop
from fsw.dictionary.enums import TOOL_SWITCHES, Mode, Switch, Tool
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, Evr, FaultCleared
from fsw.executive.modes import TRANSITIONS, Event, after
from fsw.executive.situation import Situation, name_of, pressing_of, refused, told
from fsw.executive.stow import at_stow, stop_event
from fsw.motion.move import stop
from fsw.motion.plan_press import firm_N


def clear_fault(config: Config, now: Situation, command: ClearFault) -> Situation:
    """Commands are accepted again."""
    mode = after(now.state.mode, _clearing(config, now))
    if mode is None:
        return refused(now, command, "no fault stands")
    if now.state.move is not None:
        return refused(now, command, "the arm is still being stopped")
    if now.state.sequence is not None:
        now = sequence_over(now, CommandAborted(now.state.sequence.command))
    tool = _touching_tool(now) if mode is Mode.GUARDED else now.state.tool
    state = replace(now.state, mode=mode, tool=tool, pressing=pressing_of(now, tool), fault=None)
    now = replace(now, state=state)
    return told(now, FaultCleared(), CommandCompleted(name_of(command)))


def stop_move(config: Config, now: Situation, command: Stop) -> Situation:
    """The move under way, if there is one, comes to rest early."""
    if now.state.sequence is not None:
        now = sequence_over(now, CommandAborted(now.state.sequence.command))
    now = told(now, CommandCompleted(name_of(command)))
    if now.state.move is None or now.state.mode is Mode.FAULTED:
        return now
    stopping = stop(
        config,
        now.state.move,
        TRANSITIONS[now.state.mode, stop_event(config, now.state.mode, now.state.joints)],
    )
    return replace(now, state=replace(now.state, move=stopping))


def sequence_over(now: Situation, evr: Evr) -> Situation:
    """The situation without its sequence."""
    return told(replace(now, state=replace(now.state, sequence=None)), evr)


def _touching_tool(now: Situation) -> Tool:
    """The tool whose switch is closed, or was when it should not; else the one that was to touch."""
    switches = [switch for switch in Switch if now.closed[switch]]
    if now.state.fault is not None:
        switches += [about for _, about in now.state.fault.reported if isinstance(about, Switch)]
    touching = (tool for switch in switches for tool in Tool if switch in TOOL_SWITCHES[tool])
    return next(touching, now.state.tool)


def _clearing(config: Config, now: Situation) -> Event:
    """What is cleared depends on where the arm stands: where it may touch, no free move; stowed, only unstow.

    An arm that faulted in a guarded move, in a retraction or on a contact may touch, whatever its switches
    say now; one that pressed may press.
    """
    fault = now.state.fault
    if now.state.pressing is not None and now.state.pressing.force_N > firm_N(config):
        return Event.CLEAR_PRESSED
    if now.closed.any() or (fault is not None and fault.may_touch):
        return Event.CLEAR_TOUCHING
    return Event.CLEAR_STOWED if at_stow(config, now.state.joints) else Event.CLEAR
