"""Messages of ROS 2 in the encoding CDR, read by the text of their definition."""

import re
import struct
from dataclasses import dataclass
from typing import Any, Final

PRIMITIVES: Final = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Type of a field -> its letter of `struct`."""
BUILTIN: Final = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
}
"""Definitions that files often leave out."""
FIELD: Final = re.compile(r"([\w/]+)(?:<=\d+)?(\[(<=)?(\d*)\])?\s+([A-Za-z]\w*)\s*(=?)")
ENCAPSULATION: Final = 4
"""Bytes before the content of a message; alignment counts from behind them."""


class BadMessage(Exception):
    """A definition or a message cannot be read."""


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    kind: str
    is_array: bool
    length: int | None
    """Length of an array of fixed length; None: the message says it."""


class RosReader:
    """Reader of messages of one type."""

    def __init__(self, name: str, definition: str) -> None:
        """Parse a definition, in which those of nested types follow lines of equals signs.

        Raises:
            BadMessage: a type is not defined.
        """
        first, *others = re.split(r"\n=+\nMSG: *", definition)
        texts = {**BUILTIN, _short(name): first}
        texts |= {_short(text.partition("\n")[0]): text.partition("\n")[2] for text in others}
        self._name = _short(name)
        self._fields = {kind: _parse(kind, text, texts) for kind, text in texts.items()}

    def read(self, data: bytes) -> dict[str, Any]:
        """Return the fields of a message.

        Raises:
            BadMessage: it is cut short or not of this type.
        """
        cursor = _Cursor(data, "<" if data[1:2] == b"\x01" else ">")
        try:
            return self._record(self._name, cursor)
        except (struct.error, UnicodeDecodeError) as error:
            raise BadMessage(f"a message of {self._name} does not fit its definition") from error

    def _record(self, kind: str, cursor: "_Cursor") -> dict[str, Any]:
        found: dict[str, Any] = {}
        for one in self._fields[kind]:
            if not one.is_array:
                found[one.name] = self._value(one.kind, cursor)
                continue
            length = cursor.number("I") if one.length is None else one.length
            if one.kind in PRIMITIVES:
                found[one.name] = cursor.numbers(PRIMITIVES[one.kind], length)
            else:
                found[one.name] = [self._value(one.kind, cursor) for _ in range(length)]
        return found

    def _value(self, kind: str, cursor: "_Cursor") -> Any:
        if kind in PRIMITIVES:
            return cursor.number(PRIMITIVES[kind])
        return cursor.text() if kind == "string" else self._record(kind, cursor)


class _Cursor:
    """Place in a message."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data = data
        self._order = order
        self._at = ENCAPSULATION

    def number(self, letter: str) -> Any:
        """Read a number, which begins at a multiple of its size."""
        return self.numbers(letter, 1)[0]

    def numbers(self, letter: str, n: int) -> tuple[Any, ...]:
        """Read several numbers of one type."""
        if n == 0:
            return ()
        size = struct.calcsize(letter)
        self._at += -(self._at - ENCAPSULATION) % size
        found = struct.unpack_from(f"{self._order}{n}{letter}", self._data, self._at)
        self._at += n * size
        return found

    def text(self) -> str:
        """Read a text, whose length counts the zero at its end."""
        n = self.number("I")
        found = self._data[self._at : self._at + n]
        if len(found) < n:
            raise struct.error
        self._at += n
        return found.rstrip(b"\0").decode()


def _parse(kind: str, text: str, known: dict[str, str]) -> tuple[_Field, ...]:
    """Parse the fields of a definition, without its constants."""
    found = []
    for line in text.splitlines():
        field = FIELD.match(line.partition("#")[0].strip())
        if field is None or field[6]:
            continue
        of = field[1]
        if of not in PRIMITIVES and of != "string":
            of = _nested(of, kind, known)
        length = int(field[4]) if field[4] and not field[3] else None
        found.append(_Field(field[5], of, bool(field[2]), length))
    return tuple(found)


def _nested(name: str, kind: str, known: dict[str, str]) -> str:
    """Return the known name of a nested type, which may leave out its package."""
    for one in (_short(name), f"{kind.partition('/')[0]}/{name}"):
        if one in known:
            return one
    by_end = [one for one in known if one.rpartition("/")[2] == name.rpartition("/")[2]]
    if len(by_end) == 1:
        return by_end[0]
    raise BadMessage(f"type {name!r} of {kind} is not defined in the file")


def _short(name: str) -> str:
    """Return a type without the folder in its middle: a/msg/B is a/B."""
    return name.strip().replace("/msg/", "/")
