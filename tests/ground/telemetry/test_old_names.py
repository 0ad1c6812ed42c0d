"""Logs of versions 0.1 and 0.2 are read under today's names."""

import json
from dataclasses import fields

import pytest

from fsw.dictionary.params import Params
from fsw.estimate.reference import Reference
from ground.dictionary.entries import build_dictionary
from ground.replay.inputs import inputs_from_log
from ground.telemetry import old_names
from ground.telemetry.events import CommandEntry, EvrEntry
from ground.telemetry.header import run_header
from ground.telemetry.json_codec import record_from_json, record_to_json
from ground.telemetry.read import read_log
from ground.telemetry.recorder import Recorder
from sim.arms import arm_named
from sim.effects.catalogue import catalogue
from sim.loop import ClosedLoop, Setup
from sim.params import nominal_params
from sim.scenario.effects import effect_text, parse_effect_text
from sim.world import World
from tests.tools import TOOLS

DICTIONARY = build_dictionary()
NOMINAL = arm_named("nominal")


def fields_of(definitions, separator: str = ".") -> set[str]:
    return {f"{one.name}{separator}{field.name}" for one in definitions for field in one.fields}


TODAY = {
    "CHANNELS": fields_of(DICTIONARY.packets),
    "EVRS": {one.name for one in DICTIONARY.evrs},
    "EVR_FIELDS": fields_of(DICTIONARY.evrs),
    "COMMAND_FIELDS": fields_of(DICTIONARY.commands),
    "PARAMETERS": {one.name for one in DICTIONARY.parameters},
    "REFERENCE_FIELDS": {f"reference.{field.name}" for field in fields(Reference)},
    "EFFECT_PARAMETERS": {
        f"{name}.{field.name}" for name, kind in catalogue().items() for field in fields(kind)
    },
}


@pytest.mark.parametrize("table", TODAY)
def test_every_old_name_has_a_name_of_today_and_is_none_itself(table):
    names = getattr(old_names, table)
    assert set(names.values()) <= TODAY[table]
    assert not set(names) & TODAY[table]


def test_a_log_with_parameters_of_0_1_has_those_of_today(tmp_path):
    loop = ClosedLoop(Setup(NOMINAL, World(), NOMINAL.params.poses.ready_rad))
    header = run_header(loop, "nominal", 0, {}, ())
    for old, new in old_names.PARAMETERS.items():
        before, after = (json.dumps(name.rpartition(".")[2]) + ":" for name in (new, old))
        assert before in header["params"]
        header["params"] = header["params"].replace(before, after)
    with Recorder(tmp_path / "old.mcap", header) as recorder:
        recorder.write(loop.cycle())
    log = read_log(tmp_path / "old.mcap")
    assert log.has_old_parameters
    assert inputs_from_log(log).notes == ()


def test_events_have_todays_names_fields_and_texts():
    old = EvrEntry(3, 4, "NoHardstop", "", json.dumps({"joint": "ELBOW", "drawn_urad_Nm": 25.0}))
    new = old_names.rename_evr(old)
    assert (new.name, new.fields) == ("HardstopImplausible", {"joint": "ELBOW", "nominal_urad_Nm": 25.0})
    text = "motion.load_period: must be a whole number, is 2.5"
    refused = EvrEntry(3, 4, "CommandRefused", text, json.dumps({"reason": text}))
    assert old_names.rename_evr(refused).message == text.replace("load_period", "load_period_cycles")
    assert old_names.rename_evr(refused).fields["reason"].startswith("motion.load_period_cycles:")
    assert old_names.rename_evr(new) == new


def test_commands_have_todays_arguments_and_set_todays_parameters():
    calibrate = CommandEntry(0, "Calibrate", json.dumps({"joint": "ELBOW", "anew": True}))
    assert old_names.rename_command(calibrate).fields == {"joint": "ELBOW", "accept_moved": True}
    setting = CommandEntry(0, "SetParam", json.dumps({"name": "preload.most_N", "value": 300.0}))
    assert old_names.rename_command(setting).fields == {"name": "preload.max_force_N", "value": 300.0}


CABLE = "flex-cable:elbow:stiffness_Nm_rad=1.0,drag_Nm=2.0,laid_rad=0.1,give_rad=0.2"


def test_a_header_has_todays_names_of_reference_commands_and_effects():
    old = {
        "boot": json.dumps({"mode": "READY", "reference": {"half_gap_rad": [0.0] * 5}}),
        "commands": json.dumps([{"type": "MoveTeachPoint", "fields": {"away_m": 0.1}}]),
        "effects": json.dumps(
            ["flex-cable:elbow:stiffness_Nm_rad=1.0,drag_Nm=2.0,laid_rad=0.1,give_rad=0.2"]
        ),
        "params": "{",
        "arm": "nominal",
    }
    new = old_names.rename_header(old)
    assert json.loads(new["boot"])["reference"] == {"half_backlash_rad": [0.0] * 5}
    assert json.loads(new["commands"])[0]["fields"] == {"standoff_m": 0.1}
    (text,) = json.loads(new["effects"])
    assert effect_text(parse_effect_text(text, TOOLS)) == text
    assert (new["params"], new["arm"]) == ("{", "nominal")
    assert old_names.rename_header(new) == new


def in_the_form_of_0_2(params: Params) -> dict:
    """Return parameters as a header of 0.2 has them."""
    document = record_to_json(params)
    tools = {tool.pop("name").lower(): tool for tool in document["tools"]}
    shapes = {name: tool.pop("geometry") for name, tool in tools.items() if tool.pop("title")}
    collision = document["collision"]
    rover = {part.pop("name"): part for part in collision["rover"]}
    del document["switches"]
    return {
        **document,
        "tools": tools,
        "collision": {**collision, "arm": {**collision["arm"], **shapes}, "rover": rover},
    }


def test_parameters_of_0_2_are_those_of_today():
    params = nominal_params()
    old, today = json.dumps(in_the_form_of_0_2(params)), json.dumps(record_to_json(params))
    new = old_names.rename_header({"params": old})["params"]
    assert record_from_json(Params, json.loads(new), "params", notes := []) == params
    assert notes == []
    assert old_names.rename_header({"params": today})["params"] == today


def test_parameters_of_no_known_form_stay_as_they_are():
    text = json.dumps({"tools": {"drill": {}}, "collision": 3})
    assert old_names.rename_header({"params": text})["params"] == text
