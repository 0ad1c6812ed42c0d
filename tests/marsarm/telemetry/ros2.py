"""Decoder of ROS 2 messages that uses only the text of their definitions."""

import re
import struct
from typing import Any

CODES = {
    "bool": "?", "byte": "B", "char": "b", "float32": "f", "float64": "d",
    **{f"{sign}int{bits}": code for bits, pair in {8: "bB", 16: "hH", 32: "iI", 64: "qQ"}.items()
       for sign, code in zip(("", "u"), pair, strict=True)},
}  # fmt: skip
LINE = re.compile(r"(?P<type>[a-zA-Z0-9_/]+)(?P<array>\[\d*\])?\s+(?P<name>[a-z][a-z0-9_]*)(?P<rest>\s.*)?$")
CONSTANT = re.compile(r"\w+\s+[A-Z][A-Z0-9_]*\s*=")


def parts_of(text: str) -> dict[str, list[tuple[str, str | None, str]]]:
    """Return type, array and name of the fields of a definition ("") and of the types it uses, by type."""
    first, *others = re.split(r"^={80}\nMSG: ", text, flags=re.MULTILINE)
    blocks = {"": first} | {block.split("\n", 1)[0].strip(): block.split("\n", 1)[1] for block in others}
    return {name: fields_of(block) for name, block in blocks.items()}


def fields_of(block: str) -> list[tuple[str, str | None, str]]:
    found = []
    for line in block.splitlines():
        bare = line.split("#")[0].strip()
        if not bare or CONSTANT.match(bare):
            continue
        field = LINE.match(bare)
        assert field is not None, f"not a field: {line!r}"
        found.append((field["type"], field["array"], field["name"]))
    return found


class Decoder:
    """Decoder of one message, which must end with its bytes."""

    def __init__(self, text: str, data: bytes) -> None:
        assert data[:4] == b"\0\1\0\0"
        self._parts, self._data, self._at = parts_of(text), data[4:], 0

    def message(self) -> dict[str, Any]:
        found = self._struct("")
        assert self._at == len(self._data), f"{len(self._data) - self._at} bytes are left over"
        return found

    def _struct(self, name: str) -> dict[str, Any]:
        return {field: self._value(kind, array) for kind, array, field in self._parts[name]}

    def _value(self, kind: str, array: str | None) -> Any:
        if array is None:
            return self._one(kind)
        count = self._number("I") if array == "[]" else int(array[1:-1])
        return [self._one(kind) for _ in range(count)]

    def _one(self, kind: str) -> Any:
        if kind == "string":
            length = self._number("I")
            self._at += length
            assert self._data[self._at - 1] == 0
            return self._data[self._at - length : self._at - 1].decode()
        return self._number(CODES[kind]) if kind in CODES else self._struct(kind)

    def _number(self, code: str) -> Any:
        size = struct.calcsize(code)
        self._at += -self._at % size
        (value,) = struct.unpack_from(f"<{code}", self._data, self._at)
        self._at += size
        return value
