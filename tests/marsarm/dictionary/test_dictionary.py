"""The dictionary: its entries, and the command that shows them."""

from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import get_args

import numpy as np
import pytest

from fsw.dictionary import evrs, faults
from fsw.dictionary.commands import Command, Stop
from fsw.dictionary.faults import Fault
from fsw.protect.responses import RESPONSE_TO
from marsarm.dictionary.entries import Dictionary, build_dictionary
from marsarm.telemetry.schema import arm_names, array_shape, unit_of
from marsarm.telemetry.topics import PACKET_TOPICS
from sim.arms import arm_named, nominal_params
from sim.effects.catalogue import catalogue
from sim.loop import ClosedLoop, Setup
from sim.setting import World
from tests.marsarm.command import marsarm, marsarm_json


def test_the_document_has_all_sections_and_nothing_else_is_printed(tmp_path):
    whole = marsarm_json(tmp_path, "dictionary")
    assert whole.keys() == {"commands", "evrs", "packets", "parameters"}
    assert all(whole.values())
    elbow = next(one for one in whole["parameters"] if one["name"] == "joints.elbow.speed_rad_s")
    assert (elbow["unit"], elbow["low"], elbow["high"]) == ("rad/s", 1e-3, 0.1)


@pytest.mark.parametrize("pattern", ["MoveTool", "movetool", "MOVE_TOOL"])
def test_a_command_is_found_by_either_name(tmp_path, pattern):
    part = marsarm_json(tmp_path, "dictionary", pattern)
    assert [entry["name"] for entry in part["commands"]] == ["MoveTool"]
    assert part["evrs"] == part["packets"] == part["parameters"] == []


def test_a_pattern_narrows_to_the_fields_that_match(tmp_path):
    part = marsarm_json(tmp_path, "dictionary", "*current_A")
    assert [(p["name"], [f["name"] for f in p["fields"]]) for p in part["packets"]] == [
        ("/sensors", ["current_A"])
    ]
    records = filter(is_dataclass, (*vars(evrs).values(), *vars(faults).values()))
    fits = {one.__name__ for one in records if any(f.name.endswith("current_A") for f in fields(one))}
    assert {e["name"] for e in part["evrs"]} == fits
    assert "OverCurrent" in fits


def test_people_read_a_table_that_marks_the_truth(tmp_path):
    text = marsarm(tmp_path, "dictionary", "/truth").stdout
    assert "flight software never sees it" in " ".join(text.split())
    assert "kinetic_energy_J" in text


def test_a_pattern_that_matches_nothing_is_refused_with_what_was_meant(tmp_path):
    for pattern, meant in (("OverCurent", "OverCurrent"), ("/joint/moter_rad", "/joint.motor_rad")):
        done = marsarm(tmp_path, "dictionary", pattern)
        assert done.returncode == 2
        assert f"did you mean {meant}?" in done.stderr


@pytest.mark.parametrize("pattern", ["/joint.motor_rad", "/joint/motor_rad", "/JOINT/motor_*d"])
def test_a_channel_is_found_in_either_spelling(tmp_path, pattern):
    (packet,) = marsarm_json(tmp_path, "dictionary", pattern)["packets"]
    assert packet["name"] == "/joint"
    assert "motor_rad" in [one["name"] for one in packet["fields"]]


def test_the_catalogue_is_one_document(tmp_path):
    effects = marsarm_json(tmp_path, "dictionary", "--effects")["effects"]
    listed = {one["name"]: one for one in effects}
    assert set(listed) == set(catalogue())
    bending = listed["link-bending"]
    assert bending["place_fields"] == ["frame", "axis"]
    assert bending["places"][-1] == "arm5.z"
    (parameter,) = bending["parameters"]
    assert (parameter["name"], parameter["unit"]) == ("compliance_rad_Nm", "rad/(N m)")
    assert (parameter["neutral"], parameter["low"], parameter["typical"]) == (0.0, 0.0, 5e-6)
    assert bending["in_flight_parameters"]
    assert bending["is_hypothesis"]
    assert not listed["sensor-fault"]["is_hypothesis"]


@pytest.fixture(scope="module")
def whole() -> Dictionary:
    return build_dictionary()


def test_every_number_has_a_unit_and_nothing_else_has(whole):
    entries = (*whole.commands, *whole.evrs, *whole.packets)
    for one in (*(one for entry in entries for one in entry.fields), *whole.parameters):
        assert (one.unit is not None) == one.type.startswith(("float", "int")), one.name


def test_every_entry_and_every_field_has_a_text(whole):
    for entry in (*whole.commands, *whole.evrs, *whole.packets):
        assert entry.text, entry.name
    for one in (
        *(one for entry in (*whole.commands, *whole.packets) for one in entry.fields),
        *whole.parameters,
    ):
        assert one.text, one.name
    for evr in whole.evrs:
        for one in evr.fields:
            assert one.text or f"{{e.{one.name}" in evr.message, f"{evr.name}.{one.name}"


def test_every_command_evr_topic_and_fault_is_there(whole):
    all_kinds = (*evrs.Evr.__subclasses__(), *Fault.__subclasses__())  # the ground has events of its own
    kinds = {kind.__name__ for kind in all_kinds if kind.__module__.startswith("fsw.")}
    assert {entry.name for entry in whole.commands} == {kind.__name__ for kind in get_args(Command)}
    assert {entry.name for entry in whole.evrs} == kinds - {"Fault"}
    assert [entry.name for entry in whole.packets] == [topic.name for topic in PACKET_TOPICS.values()]
    assert {e.name: e.response for e in whole.evrs if e.response} == {
        kind.__name__: response.value for kind, response in RESPONSE_TO.items()
    }


def test_the_truth_is_marked_and_nothing_else_is(whole):
    assert [packet.name for packet in whole.packets if packet.is_truth] == ["/truth"]


def test_parameters_have_their_nominal_values_within_their_limits(whole):
    values = {one.name: one for one in whole.parameters}
    assert values["joints.elbow.gear_ratio"].default == nominal_params().joints.elbow.gear_ratio
    for one in whole.parameters:
        if one.low is not None and one.high is not None and one.default is not None:
            assert np.all((one.low <= np.array(one.default)) & (np.array(one.default) <= one.high)), one.name


def test_the_shapes_are_those_of_a_run():
    arm = arm_named("nominal", None)
    loop = ClosedLoop(Setup(arm, World("mars"), arm.params.poses.ready_rad), with_truth=True)
    cycles = [loop.cycle((Stop(),) if k == 0 else ()) for k in range(64)]
    seen = set()
    for topic in PACKET_TOPICS.values():
        packet = next(p for p in map(attrgetter(topic.path), cycles) if p is not None)
        for name in topic.field_names:
            value = getattr(packet, name)
            if isinstance(value, np.ndarray):
                assert value.shape == array_shape(topic.packet, name, arm_names(arm.params)), (
                    f"{topic.name}.{name}"
                )
                seen.add(topic.name)
    assert seen == {topic.name for topic in PACKET_TOPICS.values()}


UNITS = {
    "angle_rad": "rad",
    "gear_stiffness_Nm_rad": "N m/rad",
    "torque_constant_Nm_A": "N m/A",
    "compliance_urad_Nm": "urad/(N m)",
    "expansion_1_K": "1/K",
    "line_jerk_m_s3": "m/s3",
    "winding_min_C": "degC",
    "error_share": "1",
    "tilt_persistence": "cycle",
    "R_RT": "1",
    "arm_name": None,
}


def test_the_name_tells_the_unit():
    assert {name: unit_of(name) for name in UNITS} == UNITS
