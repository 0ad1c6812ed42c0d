"""Tables of a scenario file: commands, faults, effects, checks and taught places."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Final, get_args

import numpy as np

from fsw.dictionary.arguments import Wrong, read_arguments
from fsw.dictionary.commands import ROVER, Command, Dock
from fsw.dictionary.faults import Fault
from fsw.dictionary.params import Params
from fsw.dictionary.types import AUTO, Limits, NameMark, match_name, vector3
from fsw.executive.context import check_arguments, known_names
from fsw.kinematics.closed_form import BRANCHES
from sim.effects.faults import InjectedFault, RockGone
from sim.frames import p_R_from_N
from sim.scenario.data import Check, Injection, Placed, Preloaded, SameSpot
from sim.scenario.records import (
    TYPE_KEY,
    Findings,
    did_you_mean,
    field_keys,
    is_position,
    read_kind,
    read_record,
    upper_snake,
)
from simgap.common.toml import KeyPath

FAULT_CLASSES: Final[tuple[type[InjectedFault], ...]] = get_args(InjectedFault)
"""Frozen dataclasses with a time `at_s`; a file sets it and the other fields."""
RNAV: Final = "RNAV"
ROVER_FRAMES: Final = (RNAV, "RMECH")
"""Frames of the rover; the first is the default of positions."""
COMMAND_CLASSES: Final[dict[str, type[Command]]] = {upper_snake(kind): kind for kind in get_args(Command)}
CHECK_CLASSES: Final[dict[str, type[Check]]] = {upper_snake(kind).lower(): kind for kind in get_args(Check)}
FAULT_CLASS_BY_NAME: Final[dict[str, type[InjectedFault]]] = {
    upper_snake(kind): kind for kind in FAULT_CLASSES
}


@dataclass(frozen=True, slots=True)
class _AtTime:
    """Time of a fault in the scenario."""

    at_s: Annotated[float, Limits(0.0, 1e5)]


@dataclass(frozen=True, slots=True)
class _DuringCommand:
    """Time of a fault after the start of a command."""

    during: int
    after_s: Annotated[float, Limits(0.0, 1e5)]


def read_command(
    table: dict[str, Any], place: KeyPath, findings: Findings, points: Mapping[str, str], params: Params
) -> Command | None:
    """Read a command with positions in RMECH, by the tools of taught places; None adds to `findings`."""
    kind = read_kind(COMMAND_CLASSES, table, place, findings)
    if kind is None:
        return None
    own, known = [field.name for field in fields(kind)], known_names(params)
    positions = [one for one in own if is_position(one)]
    frames = (*ROVER_FRAMES, *known[NameMark.FRAME][1:]) if "frame" in own else ROVER_FRAMES
    rest = {key: value for key, value in table.items() if key != TYPE_KEY}
    frame = rest.pop("frame", RNAV) if positions else None
    command = read_record(kind, rest, place, findings, {"branch": (AUTO, *BRANCHES), "point": tuple(points)})
    where = match_name(frame, frames)
    if frame is not None and where is None:
        findings.report((*place, "frame"), f"{frame!r} is not known; {did_you_mean(frame, frames)}")
        return None
    if command is None:
        return None
    changed: dict[str, Any] = {}
    if where == RNAV:
        changed = {one: vector3(p_R_from_N(np.array(getattr(command, one)))) for one in positions}
    if "frame" in own:
        changed["frame"] = ROVER if where in ROVER_FRAMES else where
    command = replace(command, **changed)
    read = read_arguments(command, known)
    if isinstance(read, Wrong):
        field, _, wrong = read.text.partition(": ")
        key = next(key for key in field_keys(field, tuple).factors if key in table)
        findings.report((*place, key), f"in RMECH, {wrong}" if field in positions else wrong)
        return None
    command, problem = read, check_arguments(params, read)
    if isinstance(command, Dock) and not params.tool_switches[points[command.point]]:
        problem = f"the {points[command.point]} has no contact switch to dock with"
    if problem is not None:
        findings.report(place, f"{table[TYPE_KEY]}: {problem}")
    return command


def read_fault(
    table: dict[str, Any], place: KeyPath, findings: Findings, commands: int, has_surface: bool
) -> Injection | None:
    """Read a fault and its time, by number of commands and surface; None adds its problems to `findings`."""
    kind = read_kind(FAULT_CLASS_BY_NAME, table, place, findings)
    if kind is None:
        return None
    rest = {key: value for key, value in table.items() if key != TYPE_KEY}
    when: dict[str, Any] = {key: rest.pop(key) for key in ("during", "after_s") if key in rest}
    if "at_s" in rest and when:
        findings.report((*place, "at_s"), "counts from the beginning; give it alone, or during and after_s")
        return None
    at: _AtTime | _DuringCommand | None
    if "at_s" in rest:
        at = read_record(_AtTime, {"at_s": rest.pop("at_s")}, place, findings)
    elif when:
        at = read_record(_DuringCommand, when, place, findings)
    else:
        text = "is missing; or give during, the number of a command, and after_s"
        findings.report((*place, "at_s"), text)
        return None
    fault = read_record(kind, {**rest, "at_s": 0.0}, place, findings)
    if isinstance(fault, RockGone) and not has_surface:
        findings.report(place, f"{table[TYPE_KEY]}: there is no rock; write [world.surface]")
    if isinstance(at, _DuringCommand):
        _check_number("during", at.during, commands, place, findings)
    if fault is None or at is None:
        return None
    if isinstance(at, _DuringCommand):
        return Injection(replace(fault, at_s=at.after_s), at.during)
    return Injection(replace(fault, at_s=at.at_s))


def read_check(
    table: dict[str, Any],
    place: KeyPath,
    findings: Findings,
    points: tuple[str, ...],
    commands: int,
    has_surface: bool,
) -> Check | None:
    """Read a check, or return None and report problems."""
    kind = read_kind(CHECK_CLASSES, table, place, findings)
    if kind is None:
        return None
    rest = {key: value for key, value in table.items() if key != TYPE_KEY}
    faults = tuple(sorted({fault.__name__ for fault in Fault.__subclasses__()}))  # slots make two of each
    check = read_record(kind, rest, place, findings, {"point": points, "evr": faults})
    if check is None:
        return None
    for name in ("after", "first_after", "during"):
        if hasattr(check, name):
            _check_number(name, getattr(check, name), commands, place, findings)
    if isinstance(check, Placed | Preloaded | SameSpot) and not has_surface:
        findings.report(place, f"{table[TYPE_KEY]}: there is nothing to touch; write [world.surface]")
    return check


def _check_number(name: str, number: int, commands: int, place: KeyPath, findings: Findings) -> None:
    if not 1 <= number <= commands:
        findings.report((*place, name), f"there is no command {number}; they are numbered 1 to {commands}")
