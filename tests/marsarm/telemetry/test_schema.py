"""Layout of a message, compared with CDR decoded by hand."""

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Annotated

import numpy as np
import pytest
from numpy.typing import NDArray

from fsw.dictionary.types import Limits
from marsarm.telemetry import schema
from marsarm.telemetry.format import SchemaError
from marsarm.telemetry.log_writer import Packer
from marsarm.telemetry.schema import ArmNames, Layout, packet_layout


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


ARM = ArmNames(("drill",), ("drill_1",))
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
    return Packer("packet", packet_layout(Packet, NAMES, ARM)).pack(packet)


def test_a_message_is_cdr_as_decoded_by_hand() -> None:
    header, colour, current, *rest = BY_HAND.unpack(packed(PACKET))
    assert (header, colour, current) == (b"\x00\x01\x00\x00", 7, -0.25)
    assert rest[:9] == list(range(9))
    assert rest[9:12] == [0.5, -32768, 32767]
    assert rest[12:] == [True, True, False, True]


def test_the_ros_text_is_legal_for_foxglove_and_keeps_names_units_limits_and_docs_in_comments() -> None:
    assert packet_layout(Packet, NAMES, ARM).ros_text.splitlines() == [
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
def test_a_layout_of_what_is_no_number_is_refused(kind: str) -> None:
    with pytest.raises(ValueError, match="is no number"):
        Layout.from_json(json.dumps([["angle_rad", kind, None]]))


def test_an_array_lies_row_by_row_whatever_its_order_in_memory() -> None:
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
def test_a_packet_unlike_its_layout_is_refused_by_its_field(name: str, value: object, what: str) -> None:
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
def test_a_field_that_has_no_place_in_a_message_is_refused_by_name(names: tuple[str, ...]) -> None:
    with pytest.raises(SchemaError, match=rf"Odd\.{names[-1]}:"):
        packet_layout(Odd, names, ARM)
