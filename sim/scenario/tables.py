"""The tables of a scenario file one by one: a command, a fault, a check, a place that is taught."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Final, get_args

import numpy as np

from fsw.dictionary.commands import ROVER, Command, Dock
from fsw.dictionary.enums import TOOL_SWITCHES, Tool
from fsw.dictionary.faults import Fault
from fsw.dictionary.types import Limits, Vector3, vector3
from fsw.executive.checks import FRAME_NAMES as COMMAND_FRAMES
from fsw.executive.checks import MoveCommand, check_arguments, check_vector
from fsw.kinematics.branches import BRANCHES
from fsw.motion.plan_tool import AUTO
from sim.effects.effect import Effect, Timed
from sim.effects.environment import PowerLoss
from sim.effects.faults import Fault as Injected
from sim.effects.faults import RockGone
from sim.frames import p_R_from_N
from sim.scenario.checks import Check, GravityHeld, Placed, Preloaded, SameSpot
from sim.scenario.data import Injection, Taught
from sim.scenario.effects import BadEffect, kind_named
from sim.scenario.faults import FAULTS
from sim.scenario.names import did_you_mean, is_position, upper_snake
from sim.scenario.record import TYPE, Findings, kind_of, record_of
from sim.scenario.toml_lines import Place

RNAV: Final = "RNAV"
ROVER_FRAMES: Final = (RNAV, "RMECH")
"""The frames of the rover; where nothing is said, positions are in the first."""
FRAMES: Final = (*ROVER_FRAMES, *(frame for frame in COMMAND_FRAMES if frame != ROVER))
FARTHEST_M: Final = 20.0
COMMANDS: Final[dict[str, type[Command]]] = {upper_snake(kind): kind for kind in get_args(Command)}
CHECKS: Final[dict[str, type[Check]]] = {upper_snake(kind).lower(): kind for kind in get_args(Check)}
INJECTED: Final[dict[str, type[Injected]]] = {upper_snake(kind): kind for kind in FAULTS}


@dataclass(frozen=True, slots=True)
class _At:
    """When a fault comes."""

    at_s: Annotated[float, Limits(0.0, 1e5)]


@dataclass(frozen=True, slots=True)
class _During:
    """When a fault comes that comes during a command."""

    during: int
    after_s: Annotated[float, Limits(0.0, 1e5)]


def tables(data: dict[str, Any], what: str, findings: Findings) -> Iterator[tuple[Place, dict[str, Any]]]:
    """Each table of a list of tables, with its place."""
    found = data.get(what, [])
    if isinstance(found, list) and all(isinstance(table, dict) for table in found):
        yield from (((what, k), table) for k, table in enumerate(found))
    else:
        text = f"{what}: is no list of tables; write [[{what}]] and its keys below, once for each"
        findings.say((what,), text)


def taught_of(table: dict[str, Any], place: Place, findings: Findings) -> Taught | None:
    """A place that is taught, or None and problems."""
    point = record_of(Taught, table, place, findings, {"branch": (AUTO, *BRANCHES)})
    if point is not None:
        check_direction("approach", point.approach_N, place, findings)
        check_near("position", point.p_N_m, place, findings)
    return point


def check_near(name: str, p_m: Vector3, place: Place, findings: Findings) -> None:
    """Refuse a point that no arm comes near."""
    if max(map(abs, p_m)) > FARTHEST_M:
        text = f"{name}: is more than {FARTHEST_M:g} m away; the workspace is around 2.1, 0, -0.3 in RNAV"
        findings.say((*place, name), text)


def check_direction(name: str, direction: Vector3, place: Place, findings: Findings) -> None:
    """Refuse a direction that is none."""
    if check_vector(name, direction) is not None:
        findings.say(
            (*place, name), f"{name}: has no length; write a direction, of any length in 1e-9 .. 1e9"
        )


def command_of(
    table: dict[str, Any], place: Place, findings: Findings, points: Mapping[str, Tool]
) -> Command | None:
    """A command, its positions in RMECH, or None and problems; `points` are the taught places' tools."""
    kind = kind_of(COMMANDS, table, place, findings)
    if kind is None:
        return None
    names = [field.name for field in fields(kind)]
    positions = [name for name in names if is_position(name)]
    frames = FRAMES if "frame" in names else ROVER_FRAMES
    rest = {key: value for key, value in table.items() if key != TYPE}
    frame = rest.pop("frame", RNAV) if positions else None
    command = record_of(kind, rest, place, findings, {"branch": (AUTO, *BRANCHES), "point": tuple(points)})
    if frame is not None and frame not in frames:
        findings.say((*place, "frame"), f"frame: {frame!r} is not known; {did_you_mean(str(frame), frames)}")
        return None
    if command is None:
        return None
    changed: dict[str, Any] = {}
    if frame == RNAV:
        changed = {name: vector3(p_R_from_N(np.array(getattr(command, name)))) for name in positions}
    if "frame" in names:
        changed["frame"] = ROVER if frame in ROVER_FRAMES else frame
    command = replace(command, **changed)
    problem = check_arguments(command) if isinstance(command, MoveCommand) else None
    if isinstance(command, Dock) and not TOOL_SWITCHES[points[command.point]]:
        problem = f"the {points[command.point].name.lower()} has no contact switch to dock with"
    if problem is not None:
        findings.say(place, f"{table[TYPE]}: {problem}")
    return command


def fault_of(
    table: dict[str, Any], place: Place, findings: Findings, commands: int, has_surface: bool
) -> Injection | None:
    """A fault and when it comes, or None and problems; there are so many commands."""
    kind = kind_of(INJECTED, table, place, findings)
    if kind is None:
        return None
    rest = {key: value for key, value in table.items() if key != TYPE}
    when: dict[str, Any] = {key: rest.pop(key) for key in ("during", "after_s") if key in rest}
    if "at_s" in rest and when:
        text = "at_s: counts from the beginning; give it alone, or during and after_s"
        findings.say((*place, "at_s"), text)
        return None
    at: _At | _During | None
    if "at_s" in rest:
        at = record_of(_At, {"at_s": rest.pop("at_s")}, place, findings)
    elif when:
        at = record_of(_During, when, place, findings)
    else:
        findings.say(place, "at_s: is missing; or give during, the number of a command, and after_s")
        return None
    fault = record_of(kind, {**rest, "at_s": 0.0}, place, findings)
    if isinstance(fault, RockGone) and not has_surface:
        findings.say(place, f"{table[TYPE]}: there is no rock; write [world.surface]")
    if isinstance(at, _During):
        _check_number("during", at.during, commands, place, findings)
    if fault is None or at is None:
        return None
    if isinstance(at, _During):
        return Injection(replace(fault, at_s=at.after_s), at.during)
    return Injection(replace(fault, at_s=at.at_s))


def effect_of(table: dict[str, Any], place: Place, findings: Findings) -> Effect | None:
    """An effect that is there from the beginning, or None and problems."""
    if not isinstance(table.get(TYPE), str):
        findings.say(place, f'{TYPE}: is missing; write the name of an effect, such as "coulomb-friction"')
        return None
    try:
        kind = kind_named(table[TYPE])
    except BadEffect as error:
        findings.say((*place, TYPE), f"{TYPE}: {error}")
        return None
    if issubclass(kind, Timed | PowerLoss):
        findings.say((*place, TYPE), f"{TYPE}: {table[TYPE]} comes at a moment; write it as [[fault]]")
        return None
    rest = {key: value for key, value in table.items() if key != TYPE}
    return record_of(kind, rest, place, findings)


def check_of(
    table: dict[str, Any],
    place: Place,
    findings: Findings,
    points: tuple[str, ...],
    commands: int,
    has_surface: bool,
) -> Check | None:
    """What success means, or None and problems."""
    kind = kind_of(CHECKS, table, place, findings)
    if kind is None:
        return None
    rest = {key: value for key, value in table.items() if key != TYPE}
    faults = tuple(sorted({fault.__name__ for fault in Fault.__subclasses__()}))  # slots make two of each
    check = record_of(kind, rest, place, findings, {"point": points, "evr": faults})
    if check is None:
        return None
    for name in ("after", "first_after", "during"):
        if hasattr(check, name):
            _check_number(name, getattr(check, name), commands, place, findings)
    if isinstance(check, GravityHeld):
        check_direction("gravity", check.gravity_T, place, findings)
    if isinstance(check, Placed | Preloaded | SameSpot) and not has_surface:
        findings.say(place, f"{table[TYPE]}: there is nothing to touch; write [world.surface]")
    return check


def _check_number(name: str, number: int, commands: int, place: Place, findings: Findings) -> None:
    if not 1 <= number <= commands:
        text = f"{name}: there is no command {number}; they are numbered 1 to {commands}"
        findings.say((*place, name), text)
