"""The layout of a message, against CDR decoded by hand."""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.telemetry.errors import SchemaError
from ground.telemetry.schema import Layout, Packer, layout_of


class Colour(IntEnum):
    RED = 3
    BLUE = 7


@dataclass(frozen=True, slots=True, eq=False)
class Packet:
    valid: bool
    colour: Colour
    switch: NDArray[np.bool_]
    count: NDArray[np.int16]
    R_RT: Annotated[NDArray[np.float64], "proper rotation"]
    level: NDArray[np.float32]
    current_A: float


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
# Little-endian CDR with XCDR1 padding, written out: each value at a multiple of its size after the header.
BY_HAND = struct.Struct("<4s ?7x q 3? 1x 2h 9d f 4x d")


def packed(packet: Packet) -> bytes:
    return Packer("Packet", layout_of(PACKET, NAMES)).pack(packet)


def test_a_message_is_cdr_as_decoded_by_hand() -> None:
    header, valid, colour, *rest = BY_HAND.unpack(packed(PACKET))
    assert (header, valid, colour) == (b"\x00\x01\x00\x00", True, 7)
    assert rest[:3] == [True, False, True]
    assert rest[3:5] == [-32768, 32767]
    assert rest[5:14] == list(range(9))
    assert rest[14:] == [0.5, -0.25]


def test_numpy_views_a_message_without_a_copy() -> None:
    message = packed(PACKET)
    (view,) = np.frombuffer(message, layout_of(PACKET, NAMES).dtype)
    for name in NAMES:
        np.testing.assert_array_equal(view[name], getattr(PACKET, name))


def test_the_ros_text_is_legal_for_foxglove_and_keeps_our_names_in_comments() -> None:
    assert layout_of(PACKET, NAMES).ros_text.splitlines() == [
        "bool valid",
        "int64 colour  # Colour: 3 RED, 7 BLUE",
        "bool[3] switch",
        "int16[2] count",
        "float64[9] r_rt  # R_RT; row by row, shape (3, 3)",
        "float32[1] level",
        "float64 current_a  # current_A",
    ]


def test_a_layout_survives_its_json() -> None:
    layout = layout_of(PACKET, NAMES)
    assert Layout.from_json(layout.to_json()).dtype == layout.dtype


def test_two_packets_in_a_row_do_not_mix() -> None:
    packer = Packer("Packet", layout_of(PACKET, NAMES))
    first = packer.pack(PACKET)
    packer.pack(Packet(False, Colour.RED, ~PACKET.switch, -PACKET.count, -PACKET.R_RT, -PACKET.level, 1.0))
    assert first == packer.pack(PACKET)


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("count", np.zeros(3, np.int16), "since the first message"),
        ("count", np.zeros(2, np.int64), "since the first message"),
        ("count", np.zeros((2, 1), np.int16), "since the first message"),
        ("colour", 1 << 63, "Packet.colour: 9223372036854775808 given"),
        ("colour", 0.5, "Packet.colour: 0.5 given"),
    ],
)
def test_a_packet_unlike_the_first_is_refused(name: str, value: object, what: str) -> None:
    packer = Packer("Packet", layout_of(PACKET, NAMES))
    values = {n: getattr(PACKET, n) for n in NAMES}
    with pytest.raises(SchemaError, match=what):
        packer.pack(Packet(**{**values, name: value}))  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True, eq=False)
class Odd:
    text: str
    maybe: float | None
    words: NDArray[np.str_]
    count: NDArray[np.int64]
    Count: NDArray[np.int64]
    empty: NDArray[np.int64]
    under__score: int


ODD = Odd("a", None, np.array(["a"]), np.zeros(2, np.int64), np.zeros(2, np.int64), np.zeros(0, np.int64), 1)


@pytest.mark.parametrize(
    "names", [("text",), ("maybe",), ("words",), ("empty",), ("count", "Count"), ("under__score",)], ids=str
)
def test_a_field_that_has_no_place_in_a_message_is_refused_by_name(names: tuple[str, ...]) -> None:
    with pytest.raises(SchemaError, match=rf"Odd\.{names[-1]}:"):
        layout_of(ODD, names)
