"""Packets as fixed-layout messages: a dataclass gives the numpy type, the ROS 2 text and the CDR bytes."""

import json
import re
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from math import prod
from typing import Annotated, Any, Final, get_args, get_origin, get_type_hints

import numpy as np

from ground.telemetry.errors import SchemaError

ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""CDR, XCDR1, little endian. Alignment counts from the byte after it."""

KINDS: Final[dict[type, str]] = {bool: "|b1", int: "<i8", float: "<f8"}
STRUCTS: Final = {"|b1": struct.Struct("<?"), "<i8": struct.Struct("<q"), "<f8": struct.Struct("<d")}

# Foxglove and rosidl refuse a whole log for one capital letter or double underscore in a field's name.
ROS_NAME: Final = re.compile(r"[a-z](_?[a-z0-9]+)*")


def bare(hint: Any) -> Any:
    """The type under an Annotated."""
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def aligned(offset: int, size: int) -> int:
    """The next offset, from the start of the message, where CDR places a value of this size."""
    return offset + (len(ENCAPSULATION) - offset) % size


def definition(doc: str | None, body: str) -> bytes:
    """A ROS 2 message definition, headed by the first line of a docstring."""
    heading = (doc or "").strip().split("\n")[0]
    return f"# {heading}\n{body}".encode()


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a packet: name, numpy type ("<f8"), shape (None: not an array), a note for people."""

    name: str
    kind: str
    shape: tuple[int, ...] | None
    note: str = ""

    @property
    def ros_line(self) -> str:
        """The field in a ROS 2 message definition, where names are lower case; the comment says the rest."""
        count = "" if self.shape is None else f"[{prod(self.shape)}]"
        remarks = [] if self.name.islower() else [self.name]
        if self.shape is not None and len(self.shape) > 1:
            remarks.append(f"row by row, shape {self.shape}")
        if self.note:
            remarks.append(self.note)
        line = f"{np.dtype(self.kind).name}{count} {self.name.lower()}"
        return f"{line}  # {'; '.join(remarks)}" if remarks else line


@dataclass(frozen=True, slots=True)
class Layout:
    """The fields of a packet, in the order of its bytes."""

    fields: tuple[Field, ...]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The numpy type that views a message's bytes, encapsulation included."""
        formats = [np.dtype((f.kind, f.shape or ())) for f in self.fields]
        offsets, end = [], len(ENCAPSULATION)
        for one in formats:
            offsets.append(aligned(end, one.base.itemsize))
            end = offsets[-1] + one.itemsize
        names = [f.name for f in self.fields]
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end})

    @property
    def ros_text(self) -> str:
        """The body of the ROS 2 message definition."""
        return "".join(f"{f.ros_line}\n" for f in self.fields)

    def to_json(self) -> str:
        """The layout as a log keeps it, so that a reader needs no dataclass."""
        return json.dumps([[f.name, f.kind, f.shape] for f in self.fields])

    @classmethod
    def from_json(cls, text: str) -> "Layout":
        """The layout that `to_json` gave, without the notes."""
        rows = json.loads(text)
        return cls(tuple(Field(name, kind, shape and tuple(shape)) for name, kind, shape in rows))


def field_of(owner: str, name: str, hint: Any, value: Any) -> Field:
    """The field that an annotation declares; an array's shape is that of `value`.

    Raises:
        SchemaError: the annotation, or the array, has no fixed layout.
    """
    kind = bare(hint)
    if get_origin(kind) is np.ndarray:
        scalar = np.dtype(get_args(get_args(kind)[1])[0])
        if scalar.kind not in "biuf" or scalar.itemsize > 8:
            raise SchemaError(f"{owner}.{name}: an array of {scalar} has no ROS 2 type; use numbers or flags")
        if value.dtype != scalar or value.size == 0 or value.ndim == 0:
            raise SchemaError(f"{owner}.{name}: {value.dtype}{value.shape} given, a {scalar} array is right")
        return Field(name, scalar.str, value.shape)
    if isinstance(kind, type) and issubclass(kind, IntEnum):
        return Field(name, "<i8", None, f"{kind.__name__}: " + ", ".join(f"{e.value} {e.name}" for e in kind))
    if kind in KINDS:
        return Field(name, KINDS[kind], None)
    raise SchemaError(f"{owner}.{name}: {kind} has no fixed layout; use bool, int, float, IntEnum, NDArray")


def layout_of(packet: Any, names: Iterable[str]) -> Layout:
    """The layout of these fields of a packet, from its annotations and the shapes of its arrays.

    Raises:
        SchemaError: a field has no fixed layout, or its name in lower case is not one of its own in ROS 2.
    """
    owner = type(packet).__name__
    hints = get_type_hints(type(packet), include_extras=True)
    fields = tuple(field_of(owner, name, hints[name], getattr(packet, name)) for name in names)
    seen: set[str] = set()
    for f in fields:
        name = f.name.lower()
        if name in seen or not ROS_NAME.fullmatch(name):
            raise SchemaError(
                f"{owner}.{f.name}: taken, or no field name in ROS 2; use words joined by one _"
            )
        seen.add(name)
    return Layout(fields)


class Packer:
    """Turns packets of one layout into messages; it owns the memory of one message and reuses it."""

    def __init__(self, owner: str, layout: Layout) -> None:
        self._owner = owner
        self._message = bytearray(ENCAPSULATION).ljust(layout.dtype.itemsize, b"\0")
        view = np.frombuffer(self._message, layout.dtype)[0]
        offsets = {name: value[1] for name, value in (layout.dtype.fields or {}).items()}
        self._arrays = [(f.name, view[f.name]) for f in layout.fields if f.shape is not None]
        self._scalars = [(f.name, STRUCTS[f.kind], offsets[f.name]) for f in layout.fields if f.shape is None]

    def pack(self, packet: Any) -> bytes:
        """The message of a packet.

        Raises:
            SchemaError: an array's type or shape is not that of the first packet, or a number does not fit.
        """
        for name, view in self._arrays:
            value = getattr(packet, name)
            if value.shape != view.shape or value.dtype != view.dtype:
                raise SchemaError(
                    f"{self._owner}.{name}: {value.dtype}{value.shape} given,"
                    f" {view.dtype}{view.shape} since the first message"
                )
            view[...] = value
        for name, scalar, offset in self._scalars:
            value = getattr(packet, name)
            try:
                scalar.pack_into(self._message, offset, value)
            except struct.error as error:
                raise SchemaError(f"{self._owner}.{name}: {value!r} given, {error}") from error
        return bytes(self._message)
