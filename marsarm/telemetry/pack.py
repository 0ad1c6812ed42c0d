"""Packing of packets into MCAP message records, the only part of recording that a control cycle waits for.

The cost is set by the number of calls, not of bytes. One call of struct packs all numbers of a cycle. The
result is cut, and one join puts the pieces and the arrays in order. The join copies the arrays, so no
reference to the cycle remains.
"""

from collections.abc import Sequence
from itertools import accumulate, count, groupby
from operator import attrgetter, itemgetter
from struct import Struct, calcsize
from struct import error as StructError
from typing import Any, Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from marsarm.telemetry.errors import SchemaError
from marsarm.telemetry.mcap_writer import MESSAGE_START
from marsarm.telemetry.schema import ENCAPSULATION, Layout

MESSAGE_HEADER: Final = Struct("<BQHIQQ")
"""Opcode, length of the rest, channel, sequence, log time and publish time of a message record."""
AFTER_LENGTH: Final = MESSAGE_HEADER.size - 9
"""Bytes of the header after the length."""
DTYPE: Final = attrgetter("dtype")
STRUCT_CODES: Final = {"<i8": "q", "<f8": "d", "|b1": "?"}
"""Code of `struct` for a number of each numpy type."""


def message_record(channel: int, sequence: int, time_ns: int, data: bytes) -> bytes:
    """Encode one message as an MCAP record."""
    head = MESSAGE_HEADER.pack(Opcode.MESSAGE, AFTER_LENGTH + len(data), channel, sequence, time_ns, time_ns)
    return head + data


def number_messages(counts: dict[int, int], time_ns: int, messages: Sequence[tuple[int, bytes]]) -> bytes:
    """Encode messages as MCAP records, one after the other, and number them by channel.

    Args:
        counts: Messages so far by channel; raised here.
        time_ns: Log time of all messages.
        messages: Channel and body of each message.
    """
    records = []
    for channel, data in messages:
        records.append(message_record(channel, counts[channel], time_ns, data))
        counts[channel] += 1
    return b"".join(records)


def join_bytes(pieces: Sequence[Any]) -> bytes:
    """Join bytes and arrays, one after the other."""
    try:
        return b"".join(pieces)
    except TypeError:  # an array that does not lie row by row in memory
        return b"".join([p.tobytes() if isinstance(p, np.ndarray) else p for p in pieces])


class PacketSource(NamedTuple):
    """Source of the packets of a channel: `path` is their dotted name in the record of a cycle."""

    path: str
    channel: int
    layout: Layout


class Packer:
    """Packer of the packets that occur together in a cycle; no layout needs padding."""

    def __init__(self, sources: Sequence[PacketSource]) -> None:
        self._fields = [(f"{path}.{f.name}", f) for path, _, layout in sources for f in layout.fields]
        numbers = [name for name, f in self._fields if f.shape is None]
        arrays = [name for name, f in self._fields if f.shape is not None]
        starts = [f"start of {path}" for path, _, _ in sources]
        counts = [f"count of {path}" for path, _, _ in sources]
        values = ["time", "encapsulation", *starts, *counts, *numbers]
        order: list[tuple[str, str]] = []  # struct code of each value, empty for an array, and its name
        for path, _, layout in sources:
            order += [(f"{MESSAGE_START.size}s", f"start of {path}"), ("I", f"count of {path}")]
            order += [("Q", "time"), ("Q", "time"), (f"{len(ENCAPSULATION)}s", "encapsulation")]
            order += [
                (STRUCT_CODES[f.kind] if f.shape is None else "", f"{path}.{f.name}") for f in layout.fields
            ]
        runs = [(code, [*run]) for code, run in groupby(order, lambda one: "" if one[0] else one[1])]
        sizes = [calcsize("<" + "".join(code for code, _ in run)) for array, run in runs if not array]
        ends = [*accumulate(sizes)]
        place_of_cut = count()
        self._starts = [
            MESSAGE_START.pack(Opcode.MESSAGE, AFTER_LENGTH + layout.dtype.itemsize, channel)
            for _, channel, layout in sources
        ]
        self._numbers, self._arrays = attrgetter(*numbers), attrgetter(*arrays)
        self._values = itemgetter(*[values.index(name) for code, name in order if code])
        self._pack = Struct("<" + "".join(code for code, _ in order)).pack
        self._cut = itemgetter(*map(slice, [0, *ends], ends))
        self._pieces = itemgetter(
            *[len(ends) + arrays.index(array) if array else next(place_of_cut) for array, _ in runs]
        )
        self._dtypes = [np.dtype(f.kind) for _, f in self._fields if f.shape is not None]
        self._size = sum(MESSAGE_HEADER.size + layout.dtype.itemsize for _, _, layout in sources)

    def pack(self, cycle: Any, time_ns: int, counts: Sequence[int]) -> bytes:
        """Encode the packets of a cycle as message records.

        Args:
            cycle: Record of the cycle.
            time_ns: Log time.
            counts: Sequence number of each packet, in the order of the sources.

        Raises:
            SchemaError: an array has not the type of the layout, or a number does not fit.
        """
        arrays = self._arrays(cycle)
        values = (time_ns, ENCAPSULATION, *self._starts, *counts, *self._numbers(cycle))
        try:
            packed = self._pack(*self._values(values))
        except StructError:
            self.check(cycle)
            raise
        data = join_bytes(self._pieces((*self._cut(packed), *arrays)))
        if [*map(DTYPE, arrays)] != self._dtypes or len(data) != self._size:
            self.check(cycle)
        return data

    def check(self, cycle: Any) -> None:
        """Check every field against the layout.

        Raises:
            SchemaError: a field differs; the message names it.
        """
        for name, field in self._fields:
            given, dtype = attrgetter(name)(cycle), np.dtype(field.kind)
            if field.shape is None:
                try:
                    Struct("<" + STRUCT_CODES[field.kind]).pack(given)
                except StructError as error:
                    raise SchemaError(f"{name}: {given} given, {error}") from error
            elif given.dtype != dtype or given.shape != field.shape:
                raise SchemaError(
                    f"{name}: {given.dtype}{given.shape} given, {dtype}{field.shape} in the log's schema"
                )
