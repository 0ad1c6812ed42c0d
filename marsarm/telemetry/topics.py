"""Topics of a log, derived from the annotations of CycleRecord, and the names of their channels."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from fnmatch import fnmatchcase
from operator import attrgetter
from types import NoneType, UnionType
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

from marsarm.telemetry.schema import strip_annotated
from sim.record import CycleRecord


def channel_name(topic: str, field: str) -> str:
    """Return the name of the channel of a field."""
    return f"{topic}.{field}"


def channel_matches(topic: str, field: str, pattern: str) -> bool:
    """Return whether a pattern matches a channel as /topic.field or /topic/field; case matters."""
    spellings = (channel_name(topic, field), f"{topic}/{field}")
    return any(fnmatchcase(spelling, pattern) for spelling in spellings)


@dataclass(frozen=True, slots=True)
class Topic:
    """Topic: its name, the dotted path of its packet in a CycleRecord, and its recorded fields."""

    name: str
    path: str
    packet: type
    field_names: tuple[str, ...]

    @property
    def is_truth(self) -> bool:
        """True if `sim` defines the packet: flight software cannot see it."""
        return self.packet.__module__.split(".")[0] == "sim"


def strip_optional(hint: Any) -> Any:
    """Return the type X of an annotation `X` or `X | None`."""
    kind = strip_annotated(hint)
    if get_origin(kind) not in (Union, UnionType):
        return kind
    options = [strip_annotated(one) for one in get_args(kind) if one is not NoneType]
    return options[0] if len(options) == 1 else kind


def topics_in(owner: type, path: str = "") -> Iterator[Topic]:
    """Yield the topics of a packet type: one for its plain fields, and one for each dataclass in it.

    Tuples are left out, since they hold commands and EVRs, which are separate messages.
    """
    hints = get_type_hints(owner, include_extras=True)
    types = {f.name: strip_optional(hints[f.name]) for f in fields(owner)}
    plain = tuple(n for n, kind in types.items() if not is_dataclass(kind) and get_origin(kind) is not tuple)
    if path and plain:
        yield Topic("/" + path.rpartition(".")[2], path, owner, plain)
    for name, kind in types.items():
        if is_dataclass(kind) and isinstance(kind, type):
            yield from topics_in(kind, f"{path}.{name}".lstrip("."))


# The tick, the only plain field of CycleRecord, has no topic: it is the log time of every message.
PACKET_TOPICS: Final = tuple((topic, attrgetter(topic.path)) for topic in topics_in(CycleRecord))
