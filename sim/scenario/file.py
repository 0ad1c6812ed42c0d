"""Scenarios from TOML, checked strictly: one message has every problem, its key, and what would be right."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import numpy as np

from fsw.dictionary.params import Params
from fsw.dictionary.types import AUTO, Limits
from fsw.kinematics.closed_form import BRANCHES
from sim.arms import UnknownArm, arm_named, nominal_params
from sim.scenario.data import Check, Done, Faulted, Recovered, Scenario, StartPose, TaughtPoint
from sim.scenario.effects import read_effect
from sim.scenario.records import Findings, did_you_mean, list_tables, read_record, require_table, shorten
from sim.scenario.tables import read_check, read_command, read_fault
from sim.setting import MAX_TILT_RAD, WARM_C, Scene, Surface, World
from simgap.common.errors import RobotError
from simgap.common.toml import parse_toml, read_text

T = TypeVar("T")

TABLE_LISTS: Final = ("teach", "command", "fault", "effect", "check")
REQUIRED_LISTS: Final = ("command", "check")
MAX_SHOWN: Final = 50
"""Largest number of problems in a message."""


class BadScenario(ValueError):
    """Scenario that is refused; the message has a line for every problem, with file and path of the key."""

    def __init__(self, file: str, problems: Sequence[str]):
        self.problems = tuple(problems)
        lines = [f"{file}: {problem}" for problem in self.problems]
        more = len(lines) - MAX_SHOWN
        if more > 0:
            lines = [*lines[:MAX_SHOWN], f"{file}: and {more} more"]
        super().__init__("\n".join(lines))


@dataclass(frozen=True, slots=True)
class _ScenarioHead:
    """Keys of a file before its first table."""

    title: str
    summary: str
    arm: str = "nominal"
    start: StartPose = "stowed"


@dataclass(frozen=True, slots=True)
class _WorldTable:
    """Table [world]."""

    scene: Scene = "mars"
    tilt_roll_rad: float = 0.0
    tilt_pitch_rad: float = 0.0
    temperature_C: Annotated[float, Limits(-130.0, 50.0)] = WARM_C
    surface: Surface | None = None

    @property
    def built(self) -> World:
        """Return the world of the plant."""
        return World(self.scene, self.tilt_roll_rad, self.tilt_pitch_rad, self.surface)


def built_in_scenarios() -> dict[str, str]:
    """Return the text of every built-in scenario, by name."""
    folder = resources.files("sim").joinpath("scenarios")
    files = sorted((f for f in folder.iterdir() if f.name.endswith(".toml")), key=lambda f: f.name)
    return {file.name.removesuffix(".toml"): file.read_text(encoding="utf-8") for file in files}


def load_scenario(name: str, arm: str | None = None) -> Scenario:
    """Load a built-in scenario by name, or a file by path, with another arm; BadScenario if it is wrong."""
    texts = built_in_scenarios()
    if name in texts:
        return parse_scenario(texts[name], name, f"{name}.toml", arm)
    path = Path(name)
    if path.suffix.lower() != ".toml":
        hint = f"{did_you_mean(name, texts)}, or give the path of a .toml file"
        raise BadScenario(name, [f"there is no such scenario; {hint}"])
    try:
        text = read_text(path)
    except RobotError as error:
        raise BadScenario(name, [str(error).removeprefix(f"{name}: ")]) from error
    return parse_scenario(text, path.stem, name, arm)


def parse_scenario(text: str, name: str, file: str, arm: str | None = None) -> Scenario:
    """Parse the text of a scenario, with another arm for its own; BadScenario has every problem."""
    try:
        data = parse_toml(text, file)
    except RobotError as error:
        raise BadScenario(file, [str(error).removeprefix(f"{file}: ")]) from error
    params = _drawing_params(arm or data.get("arm"))
    findings = Findings(params.tool_names)
    scenario = _read_scenario(data, name, params, findings)
    if scenario is None or findings.problems:
        raise BadScenario(file, findings.problems)
    return scenario


def _drawing_params(arm: Any) -> Params:
    """Return the parameters of the drawing of an arm; those of the default one if there is no such arm."""
    try:
        return arm_named(str(arm or "nominal")).model.params
    except UnknownArm:
        return nominal_params()


def _read_scenario(data: dict[str, Any], name: str, params: Params, findings: Findings) -> Scenario | None:
    head = _read_head(data, findings)
    world = _read_world(data, findings)
    taught = [
        read_record(TaughtPoint, table, place, findings, {"branch": (AUTO, *BRANCHES)})
        for place, table in list_tables(data, "teach", findings)
    ]
    _check_taught(taught, findings)
    points = {point.name: point.tool for point in taught if point is not None}
    command_tables = list(list_tables(data, "command", findings))
    commands = [read_command(table, place, findings, points, params) for place, table in command_tables]
    touchable = world is None or world.surface is not None
    faults = [
        read_fault(table, place, findings, len(command_tables), touchable)
        for place, table in list_tables(data, "fault", findings)
    ]
    effects = [read_effect(table, place, findings) for place, table in list_tables(data, "effect", findings)]
    checks = [
        read_check(table, place, findings, tuple(points), len(command_tables), touchable)
        for place, table in list_tables(data, "check", findings)
    ]
    # faults and effects may be at a tool or a contact switch that the arm does not have
    of_faults = [None if one is None else one.fault for one in faults]
    for what, found in (("fault", of_faults), ("effect", effects)):
        for k, effect in enumerate(found):
            problem = None if effect is None else effect.find_misfit(params)
            if problem is not None:
                findings.report((what, k), problem)
    _check_ending(checks, findings)
    if head is None or world is None or None in (*taught, *commands, *faults, *effects, *checks):
        return None
    return Scenario(
        name=name,
        title=head.title,
        summary=head.summary,
        world=world.built,
        commands=_without_none(commands),
        checks=_without_none(checks),
        start=head.start,
        arm=head.arm,
        temperature_C=world.temperature_C,
        taught=_without_none(taught),
        faults=_without_none(faults),
        effects=_without_none(effects),
    )


def _without_none(items: list[T | None]) -> tuple[T, ...]:
    return tuple(item for item in items if item is not None)


def _read_head(data: dict[str, Any], findings: Findings) -> _ScenarioHead | None:
    own = [field.name for field in fields(_ScenarioHead)]
    known = (*own, "world", *TABLE_LISTS)
    for key in data:
        if key not in known:
            findings.report((shorten(key),), f"is not known here; {did_you_mean(key, known)}")
    for what in REQUIRED_LISTS:
        if not data.get(what):
            findings.report((what,), f"is missing; write [[{what}]] and its keys below, once for each")
    head = read_record(_ScenarioHead, {key: data[key] for key in own if key in data}, (), findings)
    if head is not None:
        if not head.title.strip():
            findings.report(("title",), "is empty; give the scenario a name for people")
        try:
            arm_named(head.arm)
        except UnknownArm as error:
            findings.report(("arm",), str(error))
    return head


def _read_world(data: dict[str, Any], findings: Findings) -> _WorldTable | None:
    table = require_table(data.get("world", {}), ("world",), findings)
    world = None if table is None else read_record(_WorldTable, table, ("world",), findings)
    if world is None:
        return None
    most = max(abs(world.tilt_roll_rad), abs(world.tilt_pitch_rad), world.built.tilt_rad)
    if most > MAX_TILT_RAD + 1e-12:
        most_deg, limit_deg = np.degrees(most), np.degrees(MAX_TILT_RAD)
        text = f"tilts the rover by {most_deg:.4g} deg; the arm is used up to {limit_deg:g} deg"
        findings.report(("world",), text)
    return world


def _check_taught(taught: list[TaughtPoint | None], findings: Findings) -> None:
    names: list[str] = []
    for k, point in enumerate(taught):
        if point is None:
            continue
        if not point.name or point.name in names:
            findings.report(("teach", k, "name"), f"{point.name!r} is empty or taken; give each its own")
        names.append(point.name)


def _check_ending(checks: list[Check | None], findings: Findings) -> None:
    """Check that a scenario has one way to end."""
    if None in checks or not checks:
        return
    ends = {type(check) for check in checks} & {Done, Faulted, Recovered}
    if not ends:
        text = 'none says how the scenario ends; add one of type "done", "faulted" or "recovered"'
        findings.report(("check",), text)
    elif Done in ends and len(ends) > 1:
        text = '"done" asks for no fault; write "recovered" for a sequence that goes on after one'
        findings.report(("check",), text)
