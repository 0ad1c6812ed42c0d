"""Scenarios from TOML, strictly: every problem at once, each with its line and with what would be right."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import numpy as np

from fsw.dictionary.commands import Command, Preload, SetParam
from fsw.dictionary.limits import Limits
from fsw.dictionary.modes import Mode
from fsw.executive.checks import MoveCommand, malformed
from fsw.executive.settings import params_with
from sim.arms import UnknownArm, arm_named
from sim.effects.environment import WARM_C
from sim.params import nominal_params
from sim.scenario.checks import Done, Faulted
from sim.scenario.data import Scenario, Start
from sim.scenario.faults import stops
from sim.scenario.modes import refusals
from sim.scenario.names import did_you_mean
from sim.scenario.record import Findings, Problem, record_of, table_of
from sim.scenario.tables import check_direction, check_of, command_of, fault_of, tables, taught_of
from sim.scenario.toml_lines import NotToml, parsed
from sim.world import MAX_TILT_RAD, Scene, Surface, World

T = TypeVar("T")

LISTS: Final = ("teach", "command", "fault", "check")
NEEDED: Final = ("command", "check")


class BadScenario(ValueError):
    """A scenario that is not to be run; a line of the message for every problem, with file and line."""

    def __init__(self, file: str, problems: list[Problem]):
        self.problems = tuple(sorted(problems))
        where = (f"{file}:{p.line}" if p.line else file for p in self.problems)
        super().__init__("\n".join(f"{at}: {p.text}" for at, p in zip(where, self.problems, strict=True)))


@dataclass(frozen=True, slots=True)
class _Head:
    """What a file says before its first table."""

    title: str
    sentence: str
    arm: str = "nominal"
    start: Start = "stowed"


@dataclass(frozen=True, slots=True)
class _World:
    """The table [world]."""

    scene: Scene = "mars"
    tilt_roll_rad: float = 0.0
    tilt_pitch_rad: float = 0.0
    temperature_C: Annotated[float, Limits(-130.0, 50.0)] = WARM_C
    surface: Surface | None = None


def shipped() -> dict[str, str]:
    """The text of every scenario that comes with the house, by name."""
    folder = resources.files("sim").joinpath("scenarios")
    files = sorted((f for f in folder.iterdir() if f.name.endswith(".toml")), key=lambda f: f.name)
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in files}


def load(name: str) -> Scenario:
    """A scenario that comes with the house, by name, or that of a TOML file, by path.

    Raises:
        BadScenario: there is none, it cannot be read, or something in it is wrong.
    """
    texts = shipped()
    if name in texts:
        return scenario_from(texts[name], name, f"{name}.toml")
    path = Path(name)
    if path.suffix != ".toml":
        hint = f"{did_you_mean(name, texts)}, or give the path of a .toml file"
        raise BadScenario(name, [Problem(0, f"there is no such scenario; {hint}")])
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise BadScenario(name, [Problem(0, f"cannot be read ({error.strerror})")]) from error
    except ValueError as error:
        raise BadScenario(name, [Problem(0, f"cannot be read as text ({error})")]) from error
    return scenario_from(text, path.stem, name)


def scenario_from(text: str, name: str, file: str) -> Scenario:
    """The scenario that a TOML text says; `file` is how messages call it.

    Raises:
        BadScenario: something in it is wrong; the message has every problem, by line.
    """
    try:
        data, lines = parsed(text)
    except NotToml as error:
        raise BadScenario(file, [Problem(error.line, str(error))]) from error
    findings = Findings(lines)
    scenario = _scenario(data, name, findings)
    if scenario is None or findings.problems:
        raise BadScenario(file, findings.problems)
    return scenario


def _scenario(data: dict[str, Any], name: str, findings: Findings) -> Scenario | None:
    head = _head(data, findings)
    table = table_of(data.get("world", {}), ("world",), findings)
    world = None if table is None else record_of(_World, table, ("world",), findings)
    if world is not None and world.surface is not None:
        check_direction("normal", world.surface.normal_N, ("world", "surface"), findings)
    taught = [taught_of(table, place, findings) for place, table in tables(data, "teach", findings)]
    points = tuple(point.name for point in taught if point is not None)
    asked = list(tables(data, "command", findings))
    commands = [command_of(table, place, findings, points) for place, table in asked]
    touchable = world is None or world.surface is not None
    faults = [
        fault_of(table, place, findings, len(asked), touchable)
        for place, table in tables(data, "fault", findings)
    ]
    checks = [
        check_of(table, place, findings, points, len(asked), touchable)
        for place, table in tables(data, "check", findings)
    ]
    if head is None or world is None or None in (*taught, *commands, *faults, *checks):
        return None
    scenario = Scenario(
        name=name,
        title=head.title,
        sentence=head.sentence,
        world=World(world.scene, world.tilt_roll_rad, world.tilt_pitch_rad, world.surface),
        commands=_all(commands),
        checks=_all(checks),
        start=head.start,
        arm=head.arm,
        temperature_C=world.temperature_C,
        taught=_all(taught),
        faults=_all(faults),
    )
    if checks and not any(isinstance(check, Done | Faulted) for check in scenario.checks):
        findings.say(
            ("check", 0), 'check: none says how the scenario ends; add one of type "done" or "faulted"'
        )
    _check_tilt(scenario.world, findings)
    _check_sequence(scenario, findings)
    return scenario


def _all(items: list[T | None]) -> tuple[T, ...]:
    return tuple(item for item in items if item is not None)


def _head(data: dict[str, Any], findings: Findings) -> _Head | None:
    own = [field.name for field in fields(_Head)]
    known = (*own, "world", *LISTS)
    for key in data:
        if key not in known:
            findings.say((key,), f"{key}: is not known here; {did_you_mean(key, known)}")
    for what in NEEDED:
        if not data.get(what):
            findings.say((), f"{what}: is missing; write [[{what}]] and its keys below, once for each")
    head = record_of(_Head, {key: data[key] for key in own if key in data}, (), findings)
    if head is not None:
        try:
            arm_named(head.arm)
        except UnknownArm as error:
            findings.say(("arm",), f"arm: {error}")
    return head


def _check_tilt(world: World, findings: Findings) -> None:
    most = max(abs(world.tilt_roll_rad), abs(world.tilt_pitch_rad), world.tilt_rad)
    if most > MAX_TILT_RAD + 1e-12:
        most_deg, limit_deg = np.degrees(most), np.degrees(MAX_TILT_RAD)
        text = f"world: tilts the rover by {most_deg:.4g} deg; the arm is used up to {limit_deg:g} deg"
        findings.say(("world",), text)


def _check_sequence(scenario: Scenario, findings: Findings) -> None:
    """Refuse a sequence that flight software would be bound to refuse halfway."""
    bound = [fault.during for fault in scenario.faults if stops(fault.fault)]
    faulting = [number for number in bound if number is not None]
    timed = any(fault.during is None for fault in scenario.faults)
    during = [fault.during for fault in scenario.faults if fault.during is not None]
    troubled = range(1, len(scenario.commands) + 1) if timed else during
    start = Mode.STOWED if scenario.start == "stowed" else Mode.DEPLOYED
    for number, problem in refusals(scenario.commands, start, faulting, troubled):
        findings.say(("command", number - 1), f"command {number}: {problem}")
    for k, point in enumerate(scenario.taught):
        if not point.name or point.name in [other.name for other in scenario.taught[:k]]:
            findings.say(("teach", k, "name"), f"name: {point.name!r} is empty or taken; give each its own")
    for number, problem in _senseless(scenario.commands):
        findings.say(("command", number - 1), f"command {number}: {problem}")


def _senseless(commands: tuple[Command, ...]) -> Iterator[tuple[int, str]]:
    """Commands, by their number from 1, that flight software refuses for their own numbers and words."""
    params = nominal_params()
    for number, command in enumerate(commands, start=1):
        problem: str | None = None
        if isinstance(command, SetParam):
            changed = params_with(params, command)
            params, problem = (params, changed) if isinstance(changed, str) else (changed, None)
        elif isinstance(command, Preload) and not 0 <= command.force_N <= params.preload.most_N:
            problem = f"force {command.force_N:g} N is outside 0 .. {params.preload.most_N:g} N"
        elif isinstance(command, MoveCommand):
            problem = malformed(command)
        if problem is not None:
            yield number, problem
