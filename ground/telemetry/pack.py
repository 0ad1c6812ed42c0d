"""Packets into MCAP message records, the one part of recording that a control cycle waits for.

A record is joined from its numbers, packed, and its arrays as they are: several times faster than to copy
each array into its place. The join copies them once, so that nothing of the cycle is held on to.
"""

from collections.abc import Callable, Sequence
from operator import attrgetter
from struct import Struct
from struct import error as StructError
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode

from ground.telemetry.errors import SchemaError
from ground.telemetry.schema import ENCAPSULATION, Field, Layout

HEAD: Final = Struct("<BQHIQQ")
"""Opcode, length of the rest, channel, sequence, log time and publish time of a message record."""
AFTER_LENGTH: Final = HEAD.size - 9
CODES: Final = {"<i8": "q", "<f8": "d", "|b1": "?"}
"""How struct writes a number that is no array."""


def message_record(channel: int, sequence: int, time_ns: int, data: bytes) -> bytes:
    """One message as an MCAP record."""
    head = HEAD.pack(Opcode.MESSAGE, AFTER_LENGTH + len(data), channel, sequence, time_ns, time_ns)
    return head + data


def numbered(counts: dict[int, int], time_ns: int, messages: Sequence[tuple[int, bytes]]) -> bytes:
    """The records of messages by channel, back to back; counts them."""
    records = []
    for channel, data in messages:
        records.append(message_record(channel, counts[channel], time_ns, data))
        counts[channel] += 1
    return b"".join(records)


def getter(fields: Sequence[Field]) -> Callable[[Any], tuple[Any, ...]]:
    """Gives these fields of a packet."""
    if not fields:
        return lambda _: ()
    get = attrgetter(*[f.name for f in fields])
    return get if len(fields) > 1 else lambda packet: (get(packet),)


def joined(pieces: list[Any]) -> bytes:
    """Bytes and arrays, one after the other."""
    try:
        return b"".join(pieces)
    except TypeError:  # an array in another order in memory than row by row
        return b"".join([p.tobytes() if isinstance(p, np.ndarray) else p for p in pieces])


class Packer:
    """Turns the packets of one channel into message records; the layout is one that needs no padding."""

    def __init__(self, owner: str, channel: int, layout: Layout) -> None:
        self._owner = owner
        large = [f for f in layout.fields if f.shape is None and f.size == 8]
        flags = [f for f in layout.fields if f.shape is None and f.size == 1]
        arrays = [f for f in layout.fields if f.shape is not None]
        self._arrays = getter(arrays)
        self._numbers = getter(large)
        self._flags = getter(flags)
        self._n_before_flags = sum(f.size > 1 for f in arrays) if flags else len(arrays)
        self._fields = arrays
        self._dtypes = [np.dtype(f.kind) for f in arrays]
        self._begin = Struct(f"{HEAD.format}{len(ENCAPSULATION)}s" + "".join(CODES[f.kind] for f in large))
        self._middle = Struct("<" + "".join(CODES[f.kind] for f in flags)) if flags else None
        size = layout.dtype.itemsize
        self._constant = (Opcode.MESSAGE.value, AFTER_LENGTH + size, channel)
        self.size = HEAD.size + size
        """Of each of its records."""
        self.count = 0
        """Messages so far; the sequence number of the next."""

    def pack(self, packet: Any, time_ns: int, into: list[Any]) -> None:
        """Add the pieces of a packet's record; whether its arrays are as long as declared, its length shows.

        Raises:
            SchemaError: an array's type is not that of the layout, or a number does not fit.
        """
        arrays = self._arrays(packet)
        if [a.dtype for a in arrays] != self._dtypes:
            self.check(packet)
        try:
            into.append(
                self._begin.pack(
                    *self._constant, self.count, time_ns, time_ns, ENCAPSULATION, *self._numbers(packet)
                )
            )
        except StructError as error:
            raise SchemaError(f"{self._owner}: {self._numbers(packet)} given, {error}") from error
        if self._middle is None:
            into += arrays
        else:
            into += arrays[: self._n_before_flags]
            into.append(self._middle.pack(*self._flags(packet)))
            into += arrays[self._n_before_flags :]

    def check(self, packet: Any) -> None:
        """See that every array has the type and shape of the layout; SchemaError names one that has not."""
        for field, dtype, array in zip(self._fields, self._dtypes, self._arrays(packet), strict=True):
            if array.dtype != dtype or array.shape != field.shape:
                raise SchemaError(
                    f"{self._owner}.{field.name}: {array.dtype}{array.shape} given,"
                    f" {dtype}{field.shape} in the log's schema"
                )
