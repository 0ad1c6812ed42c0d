"""Every class is in the dictionary, and every entry has its unit and its text."""

from operator import attrgetter
from typing import get_args

import numpy as np
import pytest

from fsw.dictionary.commands import Command, Stop
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import Fault
from fsw.protect.responses import RESPONSE_TO
from marsarm.common.fields import unit_of
from marsarm.dictionary.entries import Definition, Dictionary, FieldDefinition, build_dictionary
from marsarm.telemetry.schema import arm_names, array_shape
from marsarm.telemetry.topics import PACKET_TOPICS
from sim.arms import arm_named
from sim.loop import ClosedLoop, Setup
from sim.params import nominal_params
from sim.setting import World


@pytest.fixture(scope="module")
def whole() -> Dictionary:
    return build_dictionary()


def fields_of(whole: Dictionary) -> list[tuple[str, FieldDefinition]]:
    entries: list[Definition] = [*whole.commands, *whole.evrs, *whole.packets]
    named = [(f"{entry.name}.{one.name}", one) for entry in entries for one in entry.fields]
    return named + [(one.name, one) for one in whole.parameters]


def test_every_number_has_a_unit_and_nothing_else_has(whole: Dictionary) -> None:
    for name, one in fields_of(whole):
        assert (one.unit is not None) == one.type.startswith(("float", "int")), name


def test_every_entry_and_every_field_has_a_text(whole: Dictionary) -> None:
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


def test_every_command_evr_topic_and_fault_is_there(whole: Dictionary) -> None:
    all_kinds = (*Evr.__subclasses__(), *Fault.__subclasses__())  # the ground has events of its own
    kinds = {kind.__name__ for kind in all_kinds if kind.__module__.startswith("fsw.")}
    assert {entry.name for entry in whole.commands} == {kind.__name__ for kind in get_args(Command)}
    assert {entry.name for entry in whole.evrs} == kinds - {"Fault"}
    assert [entry.name for entry in whole.packets] == [topic.name for topic in PACKET_TOPICS.values()]
    assert {e.name: e.response for e in whole.evrs if e.response} == {
        kind.__name__: response.value for kind, response in RESPONSE_TO.items()
    }


def test_the_truth_is_marked_and_nothing_else_is(whole: Dictionary) -> None:
    assert [packet.name for packet in whole.packets if packet.is_truth] == ["/truth"]


def test_parameters_have_their_nominal_values_within_their_limits(whole: Dictionary) -> None:
    values = {one.name: one for one in whole.parameters}
    assert values["joints.elbow.gear_ratio"].default == nominal_params().joints.elbow.gear_ratio
    for one in whole.parameters:
        if one.low is not None and one.high is not None and one.default is not None:
            assert np.all((one.low <= np.array(one.default)) & (np.array(one.default) <= one.high)), one.name


def test_the_shapes_are_those_of_a_run() -> None:
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


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("angle_rad", "rad"),
        ("gear_stiffness_Nm_rad", "N m/rad"),
        ("torque_constant_Nm_A", "N m/A"),
        ("compliance_urad_Nm", "urad/(N m)"),
        ("expansion_1_K", "1/K"),
        ("line_jerk_m_s3", "m/s3"),
        ("winding_min_C", "degC"),
        ("error_share", "1"),
        ("tilt_persistence", "cycle"),
        ("R_RT", "1"),
        ("arm_name", None),
    ],
)
def test_the_name_tells_the_unit(name: str, unit: str | None) -> None:
    assert unit_of(name) == unit
