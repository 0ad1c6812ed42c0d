"""Rehearsal of scenarios: what flight software would refuse is told before the run, by its own words."""

import pytest

from fsw.dictionary.commands import (
    CalibrateAll,
    ClearFault,
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
from sim.arms import arm_named
from sim.frames import p_R_from_N
from sim.scenario.data import Done, Scenario
from sim.scenario.file import built_in_scenarios, load_scenario
from sim.scenario.rehearsal import find_impossible
from sim.setting import Surface, World

ARM = arm_named("nominal")
ROCK = Surface((2.0, 0.0, -0.2), (0.0, 0.0, -1.0))
HERE, ABOVE = (vector3(p_R_from_N([2.0, 0.0, z_m])) for z_m in (-0.2, -0.3))
DOWN, UP_T = (0.0, 0.0, 1.0), (-0.02, 0.0, -1.0)
MOVE, PLACE, TOUCH = (
    MoveTool("apxs", ABOVE, DOWN),
    PlaceTool("apxs", HERE, DOWN),
    GuardedMove("apxs", HERE, DOWN),
)
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
