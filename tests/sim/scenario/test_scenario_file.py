"""Scenario and effect files: what is wrong is refused, and what would be refused is told before the run."""

from dataclasses import MISSING, fields
from typing import get_args, get_type_hints

import numpy as np
import pytest

from fsw.dictionary.commands import (
    ROVER,
    CalibrateAll,
    ClearFault,
    Command,
    GuardedMove,
    MoveJoint,
    MoveTool,
    PlaceTool,
    Preload,
    Process,
    Retract,
    SetParam,
    SetTilt,
    Stop,
    Stow,
    ToolChange,
    Unstow,
)
from fsw.dictionary.enums import Joint
from fsw.dictionary.types import vector3
from sim.arms import arm_named, nominal_params
from sim.effects.catalogue import hypotheses
from sim.effects.environment import PowerLoss
from sim.frames import P_NR_M, p_R_from_N
from sim.scenario import tables
from sim.scenario.data import Check, Done, Injection, Placed, Scenario, TaughtPoint
from sim.scenario.effects import BadEffect, effect_file_text, read_effect_file
from sim.scenario.file import BadScenario, built_in_scenarios, load_scenario, parse_scenario
from sim.scenario.records import Findings, field_keys, read_record, upper_snake
from sim.scenario.rehearsal import find_impossible
from sim.setting import Surface, World
from tests.sim.scenario.bad import BAD, GOOD
from tests.tools import TOOLS

SAMPLES = {
    "tool": "apxs",
    "first_tool": "drill",
    "normal_R": [0.1, 0.2, 0.3],
    "backlash": "off",
    "deflection": "off",
    "branch": "shoulder-out elbow-up wrist-down",
    "frame": "drill",
    "point": "inlet",
    "evr": "NoContact",
    "name": "motion.settle_time_s",
    "sensor": "current_A",
    "kind": "biased",
}


def command(**table: object) -> Command:
    findings = Findings(TOOLS)
    found = tables.read_command(table, (), findings, {"inlet": "drill"}, nominal_params())
    assert not findings.problems
    assert found is not None
    return found


def sample(hint: object, name: str, k: int) -> object:
    """Return a value for a field as it stands in a file."""
    if name in SAMPLES:
        return SAMPLES[name]
    if hint is Joint:
        return "elbow"
    args = [arg for arg in get_args(hint) if arg is not Ellipsis]
    if hint is bool:
        return True
    if hint is int or (args and args[0] is int):
        return 1
    if args and len(args) > 1 and args[0] is float and args[1] is float:
        return [0.1 * (j + k + 1) for j in range(len(args))]
    return 0.25


@pytest.mark.parametrize(
    "kind", [*get_args(Command), *get_args(Check), *tables.FAULT_CLASSES], ids=lambda kind: kind.__name__
)
@pytest.mark.parametrize("unit", [0, 1], ids=["SI", "another unit"])
def test_every_field_of_every_dataclass_can_be_said_and_comes_back(kind, unit):
    hints = get_type_hints(kind)
    table, wanted = {}, {}
    for k, field in enumerate(fields(kind)):
        expected = sample(hints[field.name], field.name, k)
        keys = list(field_keys(field.name, hints[field.name]).factors.items())
        key, factor = keys[unit % len(keys)]
        if key.endswith("_mm") and isinstance(expected, float):
            expected *= 100  # the least distance of a command is 1 mm
        table[key] = expected
        if hints[field.name] is Joint or field.name in ("tool", "first_tool"):
            table[key] = str(expected).upper()  # a name may have any case
            wanted[field.name] = Joint[table[key]] if hints[field.name] is Joint else expected
        elif isinstance(expected, list):
            wanted[field.name] = tuple(value * factor for value in expected)
        else:
            wanted[field.name] = expected * factor if isinstance(expected, float) else expected
    findings = Findings(TOOLS)
    assert read_record(kind, table, (), findings) == kind(**wanted)
    assert not findings.problems


@pytest.mark.parametrize("kind", get_args(Command), ids=lambda kind: kind.__name__)
def test_a_command_that_says_what_it_must_has_the_defaults_of_its_dataclass(kind):
    hints = get_type_hints(kind)
    table = {}
    for k, field in enumerate(fields(kind)):
        if field.default is MISSING:
            key = next(iter(field_keys(field.name, hints[field.name]).factors))
            table[key] = sample(hints[field.name], field.name, k)
    found = command(type=upper_snake(kind), **table)
    assert type(found) is kind
    for field in fields(kind):
        if field.default is not MISSING:
            assert getattr(found, field.name) == field.default


def test_every_command_check_and_fault_has_a_name_in_the_file():
    assert set(tables.COMMAND_CLASSES.values()) == set(get_args(Command))
    assert set(tables.CHECK_CLASSES.values()) == set(get_args(Check))
    assert set(tables.FAULT_CLASS_BY_NAME.values()) == set(tables.FAULT_CLASSES)
    assert {"MOVE_TOOL", "CALIBRATE_ALL", "MOVE_TEACH_POINT"} <= set(tables.COMMAND_CLASSES)
    assert {"same_spot", "over_inlet"} <= set(tables.CHECK_CLASSES)


def test_positions_are_in_rnav_unless_another_frame_is_said():
    place = [2.0, 0.1, -0.25]
    expected = {"tool": "apxs", "approach": [0, 0, 1]}
    in_rover = tuple(float(v) for v in np.array(place) - P_NR_M)
    for kind, key, field in (
        (PlaceTool, "position_m", "p_RoTo_R_m"),
        (GuardedMove, "end_position_m", "end_p_RoTo_R_m"),
        (MoveTool, "position_m", "p_FoTo_F_m"),
    ):
        name = upper_snake(kind)
        for frame, wanted in (
            ({}, in_rover),
            ({"frame": "RNAV"}, in_rover),
            ({"frame": "RMECH"}, tuple(place)),
        ):
            found = command(type=name, **{key: place}, **expected, **frame)
            assert getattr(found, field) == wanted
            assert getattr(found, "frame", ROVER) == ROVER
    moved = command(type="MOVE_TOOL", position_mm=[0, 0, -10], frame="drill", **expected)
    assert isinstance(moved, MoveTool)
    assert (moved.p_FoTo_F_m, moved.frame) == ((0.0, 0.0, -0.01), "drill")


def test_a_whole_file_says_a_whole_scenario():
    found = parse_scenario(
        GOOD.replace('start = "ready"', 'start = "ready"\narm = "as-built:3"')
        .replace("[world]", '[world]\nscene = "earth"\ntilt_pitch_deg = -5\ntemperature_degC = -40')
        .replace("[[check]]", '[[fault]]\ntype = "POWER_LOSS"\nduring = 4\nafter_s = 2.5\n[[check]]', 1),
        "test",
        "test.toml",
    )
    assert (found.arm, found.start, found.temperature_C) == ("as-built:3", "ready", -40.0)
    assert found.world.scene == "earth"
    assert np.degrees([found.world.tilt_roll_rad, found.world.tilt_pitch_rad]) == pytest.approx([5, -5])
    assert found.world.surface == Surface((2.0, 0.0, -0.2), (0.0, 0.0, -1.0))
    assert found.taught == (TaughtPoint("inlet", "portion", (0.62, 0.05, -1.175), (0.0, 0.0, 1.0)),)
    assert found.commands[2] == Retract("apxs", 0.1)
    assert found.faults == (Injection(PowerLoss(100.0)), Injection(PowerLoss(2.5), 4))
    assert found.checks == (Done(), Placed(2, "apxs"))


def problems(text: str) -> tuple[str, ...]:
    with pytest.raises(BadScenario) as refused:
        parse_scenario(text, "test", "some/test.toml")
    assert str(refused.value).splitlines() == [f"some/test.toml: {one}" for one in refused.value.problems]
    return refused.value.problems


@pytest.mark.parametrize(("right", "wrong", "expected"), BAD)
def test_bad_input_is_refused_with_its_key_and_what_would_be_right(right, wrong, expected):
    assert GOOD.count(right) >= 1
    found = problems(GOOD.replace(right, wrong, 1))
    assert any(one.startswith(expected) for one in found), found


def test_all_problems_are_told_at_once():
    edited = GOOD.replace("tilt_roll_deg", "tilt_rol_deg").replace('"elbow"', '"elbo"')
    edited = edited.replace("distance_mm = 100\n", "").replace('"placed"', '"palced"')
    assert [one.split(":")[0] for one in problems(edited)] == [
        "world.tilt_rol_deg",
        "command[3].distance_m or distance_mm",
        "command[4].joint",
        "check[2].type",
    ]


@pytest.mark.parametrize("lists", ["", "command = []\ncheck = []\n"])
def test_a_file_without_commands_and_checks_says_what_is_missing(lists):
    found = problems(f'title = "T"\nsummary = "S."\n{lists}')
    assert [one.split(";")[0] for one in found] == ["command: is missing", "check: is missing"]
    assert {one.split(":")[0] for one in problems("")} == {"title", "summary", "command", "check"}


def test_a_scenario_or_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(BadScenario, match=r"no such scenario; did you mean sampling\? there are bit-ex"):
        load_scenario("samplin")
    with pytest.raises(BadScenario, match=r"none\.toml: cannot be read .*No such file"):
        load_scenario(str(tmp_path / "none.toml"))


@pytest.mark.parametrize(
    "effects", [(), tuple(one.typical(1.0 / 3.0) for one in hypotheses())], ids=["none", "all"]
)
def test_effects_come_back_exactly(tmp_path, effects):
    path = tmp_path / "found.toml"
    path.write_text(effect_file_text(effects, ["comment"]))
    assert read_effect_file(path, TOOLS) == effects


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[[effect]]\ntype = "coulomb-frictoin"\n', "effect[1].type: effect 'coulomb-frictoin' is not"),
        ('arm = "nominal"\n', "found.toml: arm: does not belong in a file of effects; there is only"),
        ("[[effect]\n", "found.toml: is not TOML"),
        ("# found\n", "found.toml: effect: is missing; the file holds no effect"),
        ("effect = 3\n", "found.toml: effect: is no list of tables"),
        (None, "cannot be read"),
    ],
)
def test_what_is_wrong_is_told_with_its_key(tmp_path, text, expected):
    path = tmp_path / "found.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BadEffect) as refused:
        read_effect_file(path, TOOLS)
    assert expected in str(refused.value)


ARM = arm_named("nominal")
ROCK = Surface((2.0, 0.0, -0.2), (0.0, 0.0, -1.0))
HERE, ABOVE = (vector3(p_R_from_N([2.0, 0.0, z_m])) for z_m in (-0.2, -0.3))
DOWN, UP_T = (0.0, 0.0, 1.0), (-0.02, 0.0, -1.0)
MOVE, PLACE = MoveTool("apxs", ABOVE, DOWN), PlaceTool("apxs", HERE, DOWN)
TOUCH = GuardedMove("apxs", HERE, DOWN)
CHANGE, HOVER = ToolChange("mahli"), ToolChange("mahli", hover_m=0.05)
PRESS, RELEASE = Preload("apxs", 50.0), Preload("apxs", 0.0)
BACK = Retract("apxs", 0.1)


def find(*commands, start="ready"):
    return find_impossible(Scenario("test", "T", "S.", World(surface=ROCK), commands, (Done(),), start), ARM)


FINE = {
    "a placement": ("stowed", (Unstow(), MOVE, PLACE, BACK, Stow())),
    "contact again and again": ("ready", (MOVE, TOUCH, BACK, TOUCH)),
    "a tool change": ("ready", (PLACE, CHANGE, Retract("mahli", 0.1), MOVE)),
    "a tool that hovers": ("ready", (PLACE, HOVER, MOVE)),
    "a press": ("ready", (PLACE, PRESS, Preload("apxs", 80.0), Preload("apxs", 12.0), RELEASE, BACK)),
    "there and back": ("stowed", (Unstow(), Stow(), Unstow())),
    "joints": ("ready", (CalibrateAll(), MoveJoint(Joint.ELBOW, 1.9), Process("portion", UP_T, 1.0))),
    "a hardstop elsewhere": (
        "ready",
        (SetParam("joints.turret.hardstop_rad", -0.38646), CalibrateAll(), MoveJoint(Joint.TURRET, 0.0)),
    ),
    "settings anywhere": ("stowed", (SetTilt(0.0, 0.0), Stop(), Unstow(), SetTilt(0.0, 0.0))),
    "what comes after a fault": ("ready", (PLACE, ClearFault(), PLACE, PLACE)),
}
REFUSED = [
    ("stowed", (MOVE,), "MOVE_TOOL: not allowed in mode STOWED"),
    ("stowed", (Unstow(), Unstow()), "UNSTOW: not allowed in mode DEPLOYED"),
    ("ready", (MOVE, TOUCH, Stow()), "STOW: not allowed in mode GUARDED"),
    ("ready", (PLACE, CalibrateAll()), "CALIBRATE_ALL: not allowed in mode GUARDED"),
    ("ready", (MOVE, PRESS), "PRELOAD: not allowed in mode DEPLOYED"),
    ("ready", (PLACE, PRESS, BACK), "RETRACT: not allowed in mode PRELOAD"),
    ("ready", (PLACE, Preload("apxs", 1000.0)), "PRELOAD: force 1000 N is outside 0 .. "),
    ("ready", (CHANGE,), "TOOL_CHANGE: drill touches nothing: there is no spot to go back to"),
    ("ready", (PLACE, ToolChange("apxs")), "TOOL_CHANGE: apxs is the tool that touches"),
    ("ready", (PLACE, MOVE), "MOVE_TOOL: not allowed in mode GUARDED"),
    ("ready", (PLACE, Retract("drill", 0.1)), "RETRACT: apxs is the tool that may touch"),
    ("ready", (PLACE, CHANGE, BACK), "RETRACT: mahli is the tool that may touch"),
    (
        "ready",
        (SetParam("motion.settle_time_s", 1e9),),
        "SET_PARAM: motion.settle_time_s: 1000000000.0 is out",
    ),
    ("ready", (SetTilt(0.2, 0.0),), "SET_TILT: the IMU reads gravity 0.2"),
]
"""Sequences whose last command is refused."""


@pytest.mark.parametrize("name", built_in_scenarios())
def test_no_scenario_of_the_house_is_refused(name):
    scenario = load_scenario(name)
    assert find_impossible(scenario, scenario.fit_arm(ARM)) is None


@pytest.mark.parametrize("case", FINE)
def test_what_flight_software_does_is_not_refused(case):
    start, commands = FINE[case]
    assert find(*commands, start=start) is None


@pytest.mark.parametrize(("start", "commands", "expected"), REFUSED)
def test_what_flight_software_refuses_is_told_with_its_number_and_its_reason(start, commands, expected):
    assert (find(*commands, start=start) or "").startswith(f"command {len(commands)}, {expected}")
