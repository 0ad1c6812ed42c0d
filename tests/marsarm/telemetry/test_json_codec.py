"""Records as JSON, read back exactly or refused, and the layout of messages, compared with CDR by hand."""

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import IntEnum
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsw.config import configure
from fsw.dictionary.commands import Command, MoveJoint, SetParam
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import Fault
from fsw.dictionary.params import Params, digest
from fsw.dictionary.types import Limits
from fsw.estimate.reference import Reference, no_reference
from marsarm.telemetry import events, schema
from marsarm.telemetry.format import SchemaError
from marsarm.telemetry.log_writer import Packer
from sim.arms import arm_named


def any_of(hint: Any) -> st.SearchStrategy:
    """Return a strategy for every value of an annotated type."""
    kind = schema.strip_optional(hint)
    if get_origin(kind) is Literal:
        return st.sampled_from(get_args(kind))
    if get_origin(kind) is tuple:
        return st.tuples(*map(any_of, get_args(kind)))
    if issubclass(kind, IntEnum):
        return st.sampled_from(kind)
    return {float: st.floats(), int: st.integers(), bool: st.booleans(), str: st.text()}[kind]


def any_record(kind: type) -> st.SearchStrategy:
    """Return a strategy for every value of the fields of a record."""
    hints = get_type_hints(kind, include_extras=True)
    return st.builds(kind, **{f.name: any_of(hints[f.name]) for f in fields(kind)})


def written(value: Any) -> Any:
    """Replace floats by their bits, so that NaN equals NaN and -0.0 differs from 0.0."""
    if is_dataclass(value):
        return (type(value), *(written(getattr(value, f.name)) for f in fields(value)))
    if isinstance(value, tuple):
        return tuple(map(written, value))
    return (type(value), value.hex() if isinstance(value, float) else value)


@given(st.one_of(map(any_record, get_args(Command))))
def test_every_command_comes_back_from_the_log_as_it_was(command):
    entry = events.CommandEntry.decode(events.command_entry(7, command).encode())
    notes = []
    back = events.command_from_json(entry.name, entry.fields, notes)
    assert written(back) == written(command)
    assert notes == []


@pytest.mark.parametrize("name", ["nominal", "calibrated:7", "as-built:3"])
def test_parameters_come_back_bit_for_bit(name):
    params = arm_named(name).params
    notes = []
    back = events.record_from_json(
        Params, json.loads(json.dumps(events.record_to_json(params))), "params", notes
    )
    assert back == params
    assert digest(back) == digest(params)
    assert notes == []


def test_a_reference_comes_back_bit_for_bit_with_what_is_no_number():
    params = arm_named("nominal").params
    reference = replace(
        no_reference(configure(params)), zero_rad=np.array([0.1, -0.0, np.nan, 1e-320, np.pi])
    )
    back = events.record_from_json(
        Reference, json.loads(json.dumps(events.record_to_json(reference))), "boot", []
    )
    for field in fields(Reference):
        was, now = getattr(reference, field.name), getattr(back, field.name)
        assert (was.dtype, was.tobytes()) == (now.dtype, now.tobytes())


def test_fields_of_another_version_are_reported():
    notes = []
    old = {"joint": "WRIST", "angle_rad": 1.0, "haste": 3}
    assert events.command_from_json("MoveJoint", old, notes) == MoveJoint(Joint.WRIST, 1.0)
    assert notes == [
        "MoveJoint.haste is not known today: left out",
        "MoveJoint.backlash was not known then: today's 'on' is taken",
    ]


WRONG = {
    "no such command": ("Jump", {}, "command: 'Jump' is not known; there are Calibrate, "),
    "no such joint": ("MoveJoint", {"joint": "KNEE", "angle_rad": 0.0}, "MoveJoint.joint: 'KNEE' is not"),
    "no such word": (
        "MoveJoint",
        {"joint": "WRIST", "angle_rad": 0.0, "backlash": "maybe"},
        "MoveJoint.backlash: 'maybe' is not known; there are off, on",
    ),
    "a flag for a number": ("SetParam", {"name": "a", "value": True}, "SetParam.value: True is no float"),
    "text for a number": ("SetParam", {"name": "a", "value": "1"}, "SetParam.value: '1' is no float"),
    "a number for text": ("SetParam", {"name": 1, "value": 1.0}, "SetParam.name: 1 is no str"),
    "a number beyond all floats": ("SetParam", {"name": "a", "value": 10**400}, "SetParam.value: 1000"),
    "nothing": ("SetParam", {"name": "a"}, "SetParam.value is missing"),
    "too few": ("MoveJoints", {"angle_rad": [1.0, 2.0]}, "has 2 items, 5 would be right"),
    "no list": ("MoveJoints", {"angle_rad": 1.0}, "MoveJoints.angle_rad: 1.0 is no list"),
    "no fields": ("Stop", [], "Stop: [] is not the fields of a Stop"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_command_is_a_sentence(case):
    name, arguments, message = WRONG[case]
    with pytest.raises(events.BadJson) as caught:
        events.command_from_json(name, arguments, [])
    assert message in str(caught.value)


def test_an_array_with_an_integer_beyond_all_floats_is_a_sentence():
    table = events.record_to_json(no_reference(configure(arm_named("nominal").params)))
    table["zero_rad"][1] = -(10**400)
    with pytest.raises(events.BadJson, match=r"^reference.zero_rad: \[0.0, -1000.* is no list of float64$"):
        events.record_from_json(Reference, table, "reference", [])


def test_a_whole_number_where_a_float_may_be_stays_what_it_is():
    assert isinstance(events.command_from_json("SetParam", {"name": "a", "value": 3}, []).value, int)
    assert events.command_from_json("SetParam", {"name": "a", "value": 3}, []) == SetParam("a", 3)


@pytest.mark.parametrize(
    "kind",
    [kind for kind in (*Evr.__subclasses__(), *Fault.__subclasses__()) if hasattr(kind, "text")],
    ids=lambda kind: kind.__name__,
)
@settings(max_examples=1)
@given(data=st.data())
def test_every_evr_goes_into_a_log(kind, data):
    evr = data.draw(any_record(kind))
    entry = events.evr_entry(7, evr)
    assert type(entry).decode(entry.encode()) == entry
    assert (entry.name, entry.message) == (kind.__name__, evr.message)
    assert list(entry.fields) == [f.name for f in fields(kind)]


def test_a_field_without_a_json_type_is_refused():
    with pytest.raises(SchemaError, match="object in a command or EVR"):
        events.record_to_json(object())


class Colour(IntEnum):
    RED = 3
    BLUE = 7


@dataclass(frozen=True, slots=True, eq=False)
class Packet:
    """A packet of every kind.

    More is said here.
    """

    valid: bool
    """Whether it is,
    all of it."""
    colour: Colour
    switch: NDArray[np.bool_]
    count: NDArray[np.int16]
    R_RT: NDArray[np.float64]
    level: NDArray[np.float32]
    current_A: Annotated[float, Limits(-2.0, 2.5)]


ARM = schema.ArmNames(("drill",), ("drill_1",))
NAMES = ("valid", "colour", "switch", "count", "R_RT", "level", "current_A")
PACKET = Packet(
    valid=True,
    colour=Colour.BLUE,
    switch=np.array([True, False, True]),
    count=np.array([-32768, 32767], np.int16),
    R_RT=np.arange(9.0).reshape(3, 3),
    level=np.array([0.5], np.float32),
    current_A=-0.25,
)
# Little-endian CDR, written out: the largest numbers come first, so that nothing is padded.
BY_HAND = struct.Struct("<4s q d 9d f 2h ? 3?")


@pytest.fixture(autouse=True)
def _shapes(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    shapes = {"Packet.switch": (3,), "Packet.count": (2,), "Packet.R_RT": (3, 3), "Packet.level": (1,)}
    monkeypatch.setattr(schema, "ARRAY_SHAPES", shapes)
    return


def packed(packet: Packet) -> bytes:
    return Packer("packet", schema.packet_layout(Packet, NAMES, ARM)).pack(packet)


def test_a_message_is_cdr_as_decoded_by_hand():
    header, colour, current, *rest = BY_HAND.unpack(packed(PACKET))
    assert (header, colour, current) == (b"\x00\x01\x00\x00", 7, -0.25)
    assert rest[:9] == list(range(9))
    assert rest[9:12] == [0.5, -32768, 32767]
    assert rest[12:] == [True, True, False, True]


def test_the_ros_text_is_legal_for_foxglove_and_keeps_names_units_limits_and_docs_in_comments():
    assert schema.packet_layout(Packet, NAMES, ARM).ros_text.splitlines() == [
        "int64 colour  # Colour: 3 RED, 7 BLUE",
        "float64 current_a  # current_A; [A]; -2 .. 2.5",
        "float64[9] r_rt  # R_RT; row by row, shape (3, 3)",
        "float32[1] level",
        "int16[2] count  # [count]",
        "# Whether it is, all of it.",
        "bool valid",
        "bool[3] switch",
    ]


@pytest.mark.parametrize("kind", ["<,f8", "8(f8", "V8", "<f16", "O", "<\u00ff", "<U4"])
def test_a_layout_of_what_is_no_number_is_refused(kind):
    with pytest.raises(ValueError, match="is no number"):
        schema.Layout.from_json(json.dumps([["angle_rad", kind, None]]))


def test_an_array_lies_row_by_row_whatever_its_order_in_memory():
    turned = replace(
        PACKET, R_RT=np.asfortranarray(PACKET.R_RT), count=np.array([-32768, 0, 32767, 0], np.int16)[::2]
    )
    assert packed(turned) == packed(PACKET)


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("count", np.zeros(3, np.int16), r"packet.count: int16\(3,\) given, int16\(2,\) in the log's schema"),
        ("count", np.zeros(2, np.int64), r"packet.count: int64\(2,\) given"),
        ("level", np.zeros(1, np.int32), r"packet.level: int32\(1,\) given"),
        ("colour", 1 << 63, "packet.colour: 9223372036854775808 given"),
        ("colour", 0.5, "packet.colour: 0.5 given"),
    ],
)
def test_a_packet_unlike_its_layout_is_refused_by_its_field(name, value, what):
    with pytest.raises(SchemaError, match=what):
        packed(replace(PACKET, **{name: value}))


@dataclass(frozen=True, slots=True, eq=False)
class Odd:
    text: str
    maybe: float | None
    words: NDArray[np.str_]
    count: NDArray[np.int64]
    Count: NDArray[np.int64]
    under__score: int


@pytest.mark.parametrize(
    "names", [("text",), ("maybe",), ("words",), ("count", "Count"), ("under__score",)], ids=str
)
def test_a_field_that_has_no_place_in_a_message_is_refused_by_name(names):
    with pytest.raises(SchemaError, match=rf"Odd\.{names[-1]}:"):
        schema.packet_layout(Odd, names, ARM)
