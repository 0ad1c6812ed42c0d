"""Which topic each part of a cycle goes to, read from the annotations of CycleRecord."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from fnmatch import fnmatchcase
from operator import attrgetter
from types import NoneType, UnionType
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

from ground.telemetry.schema import strip_annotated
from sim.record import CycleRecord


def channel_name(topic: str, field: str) -> str:
    """The name of a field of a topic, as it is printed everywhere."""
    return f"{topic}.{field}"


def channel_matches(topic: str, field: str, pattern: str) -> bool:
    """Whether a pattern fits a channel in either spelling; capitals count."""
    spellings = (channel_name(topic, field), f"{topic}/{field}")
    return any(fnmatchcase(spelling, pattern) for spelling in spellings)


@dataclass(frozen=True, slots=True)
class Topic:
    """One channel: its name, where in a CycleRecord its packet is, which fields of the packet it keeps."""

    name: str
    path: str
    packet: type
    field_names: tuple[str, ...]

    @property
    def is_truth(self) -> bool:
        """Whether the packet is the plant's own: flight software cannot see what sim/ defines."""
        return self.packet.__module__.split(".")[0] == "sim"


def strip_optional(hint: Any) -> Any:
    """The type X of an annotation `X` or `X | None`."""
    kind = strip_annotated(hint)
    if get_origin(kind) not in (Union, UnionType):
        return kind
    options = [strip_annotated(one) for one in get_args(kind) if one is not NoneType]
    return options[0] if len(options) == 1 else kind


def topics_in(owner: type, path: str = "") -> Iterator[Topic]:
    """The topics of a packet type: its plain fields are one, each dataclass in it is a topic by its own name.

    Tuples are left out: in a cycle they hold commands and EVRs, which are messages of their own.
    """
    hints = get_type_hints(owner, include_extras=True)
    types = {f.name: strip_optional(hints[f.name]) for f in fields(owner)}
    plain = tuple(n for n, kind in types.items() if not is_dataclass(kind) and get_origin(kind) is not tuple)
    if path and plain:
        yield Topic("/" + path.rpartition(".")[2], path, owner, plain)
    for name, kind in types.items():
        if is_dataclass(kind) and isinstance(kind, type):
            yield from topics_in(kind, f"{path}.{name}".lstrip("."))


# The tick is the time of every message of the cycle; it is CycleRecord's only plain field.
PACKET_TOPICS: Final = tuple((topic, attrgetter(topic.path)) for topic in topics_in(CycleRecord))
