"""Layout of packets as messages: units, numpy type, ROS 2 definition and JSON of fields; encoder of CDR."""

import ast
import inspect
import json
import re
import struct
import sys
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from itertools import pairwise
from math import prod
from types import NoneType, UnionType
from typing import Annotated, Any, Final, NamedTuple, Self, Union, get_args, get_origin, get_type_hints

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import Limits, NameMark
from marsarm.telemetry.format import SchemaError

UNIT_SYMBOLS: Final = {
    **{name: name for name in ("rad", "urad", "m", "s", "A", "N", "K", "J", "kg", "Hz", "Pa", "V", "W")},
    **{name: name for name in ("count", "1", "s2", "s3")},
    "Nm": "N m",
    "C": "degC",
}
"""Unit for each part of a suffix."""

DIMENSIONLESS: Final = {
    **dict.fromkeys(("tick", "cycle", "cycles", "persistence", "period"), "cycle"),
    **dict.fromkeys(("share", "fraction", "ratio", "factor", "side", "along", "across"), "1"),
    "turn": "count",
}
"""Unit for the last word of a name without a unit suffix: the counted thing, or 1 for a pure number."""

UNIT_VECTORS: Final = ("approach", "gravity", "normal", "R")
"""First words of names of directions and rotations, whose components are pure numbers."""

UNITS_BY_NAME: Final = {
    "compliance": "mixed",
    "bound": "cycle",
    "value": "of the parameter or channel",
    **dict.fromkeys(("lowest", "highest"), "of the channel"),
}
"""Unit of names for which the docstring, or another field, gives the unit."""


def unit_of(name: str) -> str | None:
    """Derive the unit of a field from its name: "1" for a pure number, None if the name has no unit."""
    words = name.split("_")
    suffix: list[str] = []
    while words and words[-1] in UNIT_SYMBOLS and len(suffix) < 2:
        suffix.insert(0, UNIT_SYMBOLS[words.pop()])
    if suffix:
        top, *below = suffix
        return top if not below else f"{top}/{below[0] if ' ' not in below[0] else f'({below[0]})'}"
    if words[-1] in DIMENSIONLESS:
        return DIMENSIONLESS[words[-1]]
    return "1" if words[0] in UNIT_VECTORS else UNITS_BY_NAME.get(name)


@cache
def field_docs(kind: type) -> dict[str, str]:
    """Read the docstrings of the fields of a dataclass, by name; fields without one are left out."""
    node = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    return _attribute_docs(node.body) if isinstance(node, ast.ClassDef) else {}


@cache
def alias_docs(module: str) -> dict[str, str]:
    """Read the docstrings of the names that a module assigns, such as `BacklashMode`."""
    return _attribute_docs(ast.parse(inspect.getsource(sys.modules[module])).body)


def class_doc(kind: type) -> str:
    """Return the docstring of a class with the lines of each paragraph joined."""
    return _unwrap(inspect.getdoc(kind) or "")


def _attribute_docs(body: list[ast.stmt]) -> dict[str, str]:
    """Collect the strings that directly follow an assignment, by the assigned name."""
    return {
        _target(node): _unwrap(inspect.cleandoc(below.value.value))
        for node, below in pairwise(body)
        if isinstance(node, ast.AnnAssign | ast.Assign)
        and isinstance(below, ast.Expr)
        and isinstance(below.value, ast.Constant)
        and isinstance(below.value.value, str)
    }


def _target(node: Any) -> str:
    return str(ast.unparse(node.target if isinstance(node, ast.AnnAssign) else node.targets[0]))


def _unwrap(text: str) -> str:
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""Encapsulation header: CDR, XCDR1, little endian. Alignment counts from the byte after it."""

DTYPES: Final[dict[type, str]] = {bool: "|b1", int: "<i8", float: "<f8"}

NUMBER: Final = re.compile(r"[<|][biuf][1248]")
"""Names of the numpy types that exist in ROS 2; numpy itself evaluates other texts as Python."""

Shape = tuple[int, ...]


class ArmNames(NamedTuple):
    """Names of tools and contact switches of an arm, on which the layout of messages depends."""

    tools: tuple[str, ...]
    switches: tuple[str, ...]


def arm_names(params: Params) -> ArmNames:
    """Return the names of the tools and switches of the arm of these parameters."""
    return ArmNames(params.tool_names, tuple(switch.name for switch in params.switches))


PER_JOINT: Final = (len(Joint),)
ARRAY_SHAPES: Final[Mapping[str, tuple[int | str, ...]]] = {
    "Sensors.switch_closed": ("switches",),
    "Sensors.gravity_R_m_s2": (3,),
    "ToolChannels.p_RoTo_R_m": (3,),
    "ToolChannels.R_RT": (3, 3),
    "Truth.p_RoTo_R_m": ("tools", 3),
    "Truth.R_RT": ("tools", 3, 3),
}
"""Shapes of arrays that are not by joint; a name stands for the number of names in ArmNames."""

# Foxglove and rosidl reject a whole log if one name of a field has a capital letter or a double underscore.
ROS_NAME: Final = re.compile(r"[a-z](_?[a-z0-9]+)*")


def strip_annotated(hint: Any) -> Any:
    """Return the type inside an Annotated."""
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def strip_optional(hint: Any) -> Any:
    """Return the type X of an annotation `X` or `X | None`."""
    kind = strip_annotated(hint)
    if get_origin(kind) not in (Union, UnionType):
        return kind
    options = [strip_annotated(one) for one in get_args(kind) if one is not NoneType]
    return options[0] if len(options) == 1 else kind


def align(offset: int, size: int) -> int:
    """Return the next offset from the start of a message where CDR places a value of this size."""
    return offset + (len(ENCAPSULATION) - offset) % size


def ros_definition(doc: str | None, body: str) -> bytes:
    """Return a ROS 2 message definition with the first line of a docstring as its comment."""
    heading = (doc or "").strip().split("\n")[0]
    return f"# {heading}\n{body}".encode()


@dataclass(frozen=True, slots=True)
class Field:
    """Field of a packet: name, numpy type such as "<f8", shape (None for a single number), comments."""

    name: str
    kind: str
    shape: Shape | None
    note: str = ""
    """Comment with unit, limits and names of the values."""
    doc: str = ""
    members: Mapping[str, int] | None = None
    """Names of the values of an enumeration or of the index of a tool; None for numbers and flags."""

    @property
    def size(self) -> int:
        """Size of one number in bytes, and its alignment."""
        return np.dtype(self.kind).itemsize

    @property
    def ros_lines(self) -> str:
        """Lines of the field in a ROS 2 message definition; names are lower case, comments hold the rest."""
        count = "" if self.shape is None else f"[{prod(self.shape)}]"
        remarks = [] if self.name.islower() else [self.name]
        if self.shape is not None and len(self.shape) > 1:
            remarks.append(f"row by row, shape {self.shape}")
        if self.note:
            remarks.append(self.note)
        line = f"{np.dtype(self.kind).name}{count} {self.name.lower()}"
        line = f"{line}  # {'; '.join(remarks)}" if remarks else line
        return f"# {self.doc}\n{line}\n" if self.doc else f"{line}\n"


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a packet: its fields in the order of the bytes."""

    fields: tuple[Field, ...]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Structured numpy type of a whole message with its encapsulation header."""
        formats = [np.dtype((f.kind, f.shape or ())) for f in self.fields]
        offsets, end = [], len(ENCAPSULATION)
        for one in formats:
            offsets.append(align(end, one.base.itemsize))
            end = offsets[-1] + one.itemsize
        names = [f.name for f in self.fields]
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": end})

    @property
    def ros_text(self) -> str:
        """Body of the ROS 2 message definition."""
        return "".join(f.ros_lines for f in self.fields)

    def to_json(self) -> str:
        """Encode the layout for a log, so that a reader needs no dataclass."""
        return json.dumps([[f.name, f.kind, f.shape] for f in self.fields])

    @classmethod
    def from_json(cls, text: str) -> "Layout":
        """Decode what `to_json` encoded, without comments; TypeError or ValueError if it is no layout."""
        rows = json.loads(text)
        if not all(NUMBER.fullmatch(kind) for _, kind, _ in rows):
            raise ValueError(f"a field is no number: {text}")
        layout = cls(tuple(Field(name, kind, shape and tuple(shape)) for name, kind, shape in rows))
        _ = layout.dtype  # raises where names, types and shapes do not fit
        return layout


def members_of(hint: Any, arm: ArmNames) -> dict[str, int] | None:
    """Return the names of the values of a field; None if it has plain numbers or flags."""
    kind = strip_annotated(hint)
    if is_tool_index(hint):
        return {tool: k for k, tool in enumerate(arm.tools)}
    if isinstance(kind, type) and issubclass(kind, IntEnum):
        return {member.name: member.value for member in kind}
    return None


def note_of(name: str, hint: Any, members: Mapping[str, int] | None) -> str:
    """Return a comment with unit, limits and names of the values of a field, as far as they exist."""
    unit = unit_of(name)
    limits = next((one for one in get_args(hint)[1:] if isinstance(one, Limits)), None)
    remarks = [] if unit in (None, "1") else [f"[{unit}]"]
    if limits is not None:
        remarks.append(f"{limits.low:g} .. {limits.high:g}")
    if members is not None:
        kind = "Tool" if is_tool_index(hint) else strip_annotated(hint).__name__
        remarks.append(f"{kind}: " + ", ".join(f"{value} {member}" for member, value in members.items()))
    return "; ".join(remarks)


def is_tool_index(hint: Any) -> bool:
    """Return whether an annotation is of an index of a tool."""
    return NameMark.TOOL in get_args(hint)[1:]


def array_shape(owner: type, name: str, arm: ArmNames) -> Shape:
    """Return the shape of an array field of a packet, for an arm with these tools and switches."""
    shape = ARRAY_SHAPES.get(f"{owner.__name__}.{name}", PER_JOINT)
    return tuple(len(getattr(arm, size)) if isinstance(size, str) else size for size in shape)


def packet_field(owner: type, name: str, hint: Any, arm: ArmNames) -> Field:
    """Return the field that an annotation declares; SchemaError if the annotation has no fixed layout."""
    kind, where, members = strip_annotated(hint), f"{owner.__name__}.{name}", members_of(hint, arm)
    doc = " ".join(field_docs(owner).get(name, "").split())
    shape = None
    if get_origin(kind) is np.ndarray:
        scalar = np.dtype(get_args(get_args(kind)[1])[0])
        if not NUMBER.fullmatch(scalar.str):
            raise SchemaError(f"{where}: an array of {scalar} has no ROS 2 type; use numbers or flags")
        dtype, shape = scalar.str, array_shape(owner, name, arm)
    elif members is not None or kind in DTYPES:
        dtype = DTYPES.get(kind, DTYPES[int])
    else:
        raise SchemaError(f"{where}: {kind} has no fixed layout; use bool, int, float, IntEnum, NDArray")
    return Field(name, dtype, shape, note_of(name, hint, members), doc, members)


def packet_layout(packet: type, names: Iterable[str], arm: ArmNames) -> Layout:
    """Return the layout of fields of a packet, from its annotations; SchemaError if ROS 2 cannot have one.

    Fields are ordered by size, the largest first, and within a size single numbers before arrays. This order
    needs no padding.
    """
    hints = get_type_hints(packet, include_extras=True)
    fields = [packet_field(packet, name, hints[name], arm) for name in names]
    seen: set[str] = set()
    for f in fields:
        name = f.name.lower()
        if name in seen or not ROS_NAME.fullmatch(name):
            raise SchemaError(
                f"{packet.__name__}.{f.name}: taken, or no field name in ROS 2; use words joined by one _"
            )
        seen.add(name)
    return Layout(tuple(sorted(fields, key=lambda f: (-f.size, f.shape is not None))))


class CdrWriter:
    """Message that is being encoded in CDR; values are added in the order of its definition."""

    def __init__(self) -> None:
        self.data = bytearray(ENCAPSULATION)

    def add(self, kind: str, *values: float) -> Self:
        """Add numbers of one type, a code of `struct` such as "d" for float64."""
        padding = (len(ENCAPSULATION) - len(self.data)) % struct.calcsize(kind)
        self.data += struct.pack(f"<{padding}x{len(values)}{kind}", *values)
        return self

    def text(self, text: str) -> Self:
        """Add a string."""
        # Text from the operating system may hold bytes that UTF-8 does not have.
        content = text.encode(errors="backslashreplace") + b"\0"
        padding = -len(self.data) % 4
        self.data += struct.pack(f"<{padding}xI", len(content)) + content
        return self
