"""Logs of messages: fields by topic, each with the times of its messages, and joints by their names."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.files import columns

NAME_FIELDS: Final = ("name", "names", "joint_names", "interface_names")
"""Fields with the names of the items of the lists beside them, in JointState and messages of controllers."""
SECONDS: Final = ("sec", "secs")
NANOSECONDS: Final = ("nanosec", "nanosecs", "nsec", "nsecs")
MAX_LISTED_BYTES: Final = 1 << 15
"""Largest message whose fields are listed: states of robots are smaller, pictures and point clouds larger."""
Place = str | int
"""Place in a list: a name where the message has one for it, else an index."""


@dataclass(frozen=True, slots=True)
class Message:
    """Message of a log, in the order of the file."""

    topic: str
    time_ns: int
    read: Callable[[], Any]
    """Decodes its content: records and dictionaries, lists and arrays, numbers and texts."""


def is_wanted(topic: str, n_bytes: int, names: Sequence[str] | None) -> bool:
    """Tell whether a message may hold a wanted field; None wants all but messages as large as pictures."""
    if names is None:
        return n_bytes <= MAX_LISTED_BYTES
    return any(name.startswith((f"{topic}.", f"{topic}[")) for name in names)


@dataclass(slots=True)
class Series:
    """Values of one field, or of one place in its lists."""

    times_ns: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)
    """Numbers; texts for a field of text."""
    numbers: list[int] = field(default_factory=list)
    """Numbers of the messages in their topic, from 1."""


@dataclass(frozen=True, slots=True)
class _Field:
    """Field that is read: its topic, the steps to it, and whether its last step is a place in a list."""

    name: str
    topic: str
    steps: tuple[str, ...]

    @property
    def place(self) -> Place | None:
        """Place in the last list; None for a field that is no item of a list."""
        return _place(self.steps[-1]) if self.steps[-1].startswith("[") else None

    @property
    def whole(self) -> str:
        """Name of the list whose item it is; its own name for a field that is no item."""
        return self.name if self.place is None else f"{self.topic}{''.join(self.steps[:-1])}"


@dataclass(frozen=True, slots=True)
class MessageLog:
    """Fields of messages."""

    path: Path
    fields: Mapping[str, _Field]
    """Fields that were asked for, by name."""
    series: Mapping[str, Mapping[Place | None, Series]]
    """Name of a list or field -> place in it -> values; the place None for a field that is no list."""
    places: Mapping[str, Mapping[int, Sequence[str]]]
    """Name of a list -> index -> the names that stood there, first to last."""
    start_ns: int
    topics: Sequence[str]
    losses: Sequence[str] = ()
    time_column: str = ""
    motion_column: str = ""

    def numbers(self, name: str) -> columns.Column:
        """Return numbers of a field with their times; RobotError for none, or if the clock steps back."""
        one = self.fields.get(name) or _parse(self.path, name, self.topics)
        series = self._series(one)
        back = next(iter(np.flatnonzero(np.diff(series.times_ns) < 0) + 1), 0)
        if back:
            before_s, after_s = ((series.times_ns[k] - self.start_ns) * 1e-9 for k in (back - 1, back))
            raise RobotError(
                f"{self.path}: topic {one.topic!r}: the clock steps back from {before_s:.6g} s to "
                f"{after_s:.6g} s at message {series.numbers[back]}; cut the file there, into one log a clock"
            )
        values = [_number(self.path, name, value) for value in series.values]
        return columns.Column(
            np.array(values, dtype=np.float64),
            None,
            self._times_s(series),
            np.array(series.numbers, np.int64),
        )

    def texts(self, name: str) -> NDArray[np.str_]:
        """Refuse: messages have no rows that a text could divide."""
        raise RobotError(
            f"{self.path}: {name!r}: a log of messages has no rows; in [motion], write windows_s in place of "
            "columns"
        )

    def names_at(self, name: str) -> Sequence[str]:
        """Return the names that stood at the place that a name gives by its index; empty if it gives none."""
        one = self.fields[name]
        place = self._place(one)
        return self.places.get(one.whole, {}).get(place, ()) if isinstance(place, int) else ()

    def _place(self, one: _Field) -> Place | None:
        """Return the place of a field; a name counts first: drivers name motors by numbers."""
        is_name = isinstance(one.place, int) and str(one.place) in self.series.get(one.whole, {})
        return str(one.place) if is_name else one.place

    def describe(self) -> tuple[columns.ColumnInfo, ...]:
        """Describe all fields that were read; items of lists have their names where they have any."""
        found = []
        for whole, places in self.series.items():
            for place, series in places.items():
                name = whole if place is None else f"{whole}[{place}]"
                found.append(self._describe(name, series))
        return tuple(found)

    def _describe(self, name: str, series: Series) -> columns.ColumnInfo:
        time_s = self._times_s(series)
        kind = _kind(series.values[0])
        if kind in ("text", "other"):
            return columns.ColumnInfo(name, kind, len(series.values))
        values = np.array([_number(self.path, name, one) for one in series.values], dtype=np.float64)
        unit = "s" if kind == "time" else ""
        return columns.describe_numbers(name, columns.Column(values, None, time_s), kind, unit)

    def _times_s(self, series: Series) -> Array:
        return np.array([time - self.start_ns for time in series.times_ns], dtype=np.float64) * 1e-9

    def _series(self, one: _Field) -> Series:
        """Return the values of a field; those at an index are of the name that first stood there."""
        there = self.series.get(one.whole, {})
        place = self._place(one)
        if isinstance(place, int):
            place = next(iter(self.places.get(one.whole, {}).get(place, ())), place)
        if place in there:
            return there[place]
        if not there and one.whole in self.series:
            return Series()  # a list that is empty in all messages
        names = [f"{one.whole}[{key}]" if key is not None else one.whole for key in there]
        raise columns.missing_column(self.path, one.name, names)


def open_messages(
    path: Path,
    names: Sequence[str] | None,
    topics: Sequence[str],
    messages: Iterable[Message],
    start_ns: int | None,
    losses: Sequence[str] = (),
) -> MessageLog:
    """Read fields such as `/joint_states.position[2]`, None for all; RobotError if one cannot be read.

    Args:
        topics: All topics of the file.
        messages: Those of the wanted topics, in the order of the file.
        start_ns: Time of the first message of all topics; None: that of `messages`.
        losses: Sentences about what could not be read.
    """
    chosen = {} if names is None else {name: _parse(path, name, topics) for name in names}
    wanted = topics if names is None else list(dict.fromkeys(one.topic for one in chosen.values()))
    wholes = {one.whole: one for one in chosen.values()}
    by_topic = {topic: [one for one in wholes.values() if one.topic == topic] for topic in wanted}
    reader = _Reader(path, {name: {} for name in wholes}, {})
    counts = dict.fromkeys(wanted, 0)
    try:
        for message in messages:
            if message.topic not in counts:
                continue
            counts[message.topic] += 1
            start_ns = message.time_ns if start_ns is None else min(start_ns, message.time_ns)
            content = message.read()
            at = message.time_ns, counts[message.topic]
            if names is None:
                reader.add_all(message.topic, content, at)
            for one in by_topic[message.topic]:
                reader.add(one, content, at)
    except RecursionError as error:
        raise RobotError(f"{path}: a message is nested too deeply; write fields of a few levels") from error
    empty = next((topic for topic, n in counts.items() if n == 0), None)
    if empty is not None and names is not None:
        raise RobotError(f"{path}: topic {empty!r} has no messages; name a topic that was recorded")
    return MessageLog(path, chosen, reader.series, reader.places, start_ns or 0, topics, tuple(losses))


@dataclass(frozen=True, slots=True)
class _Reader:
    """Values that are read so far."""

    path: Path
    series: dict[str, dict[Place | None, Series]]
    places: dict[str, dict[int, list[str]]]

    def add(self, one: _Field, content: Any, at: tuple[int, int]) -> None:
        """Add the values of a field, or of all items of its list, of one message."""
        found, names = content, _names_of(content)
        steps = one.steps if one.place is None else one.steps[:-1]
        for step in steps:
            inner = _step(found, step, names)
            if inner is _ABSENT and not isinstance(_place(step), int) and step.startswith("["):
                return  # a message of another publisher, which has no item of this name
            if inner is _ABSENT:
                raise self._missing(one, step, found)
            found, names = inner, _names_of(inner) or names
        if one.place is None:
            self._append(one.whole, None, found, at)
            return
        if not _is_list(found):
            raise self._missing(one, one.steps[-1], found)
        self._append_items(one.whole, found, names, at)

    def add_all(self, name: str, content: Any, at: tuple[int, int], names: Sequence[str] = ()) -> None:
        """Add all numbers and texts of a message, or of a part of it; long lists are left out."""
        if _seconds(content) is not None:
            self._append(name, None, content, at)
        elif (inner := _fields_of(content)) is not None:
            own = _names_of(content) or names
            for key, value in inner.items():
                if value is not own:
                    self.add_all(f"{name}.{key}", value, at, own)
        elif not _is_list(content):
            self._append(name, None, content, at)
        elif 0 < len(content) <= columns.MAX_LISTED:
            if _fields_of(content[0]) is None and not _is_list(content[0]):
                self._append_items(name, content, names, at)
            else:
                for k, value in enumerate(content):
                    place = names[k] if len(names) == len(content) else k
                    self.add_all(f"{name}[{place}]", value, at)

    def _append_items(self, name: str, found: Any, names: Sequence[str], at: tuple[int, int]) -> None:
        values = found.tolist() if isinstance(found, np.ndarray) else found
        has_names = bool(names) and len(names) == len(values)
        for k, value in enumerate(values):
            if has_names:
                stood = self.places.setdefault(name, {}).setdefault(k, [])
                if names[k] not in stood:
                    stood.append(names[k])
            self._append(name, names[k] if has_names else k, value, at)

    def _append(self, name: str, place: Place | None, value: Any, at: tuple[int, int]) -> None:
        series = self.series.setdefault(name, {}).setdefault(place, Series())
        series.times_ns.append(at[0])
        series.numbers.append(at[1])
        series.values.append(value)

    def _missing(self, one: _Field, step: str, content: Any) -> RobotError:
        there = _fields_of(content)
        has = "is no record" if step[0] == "." else "is not so long"
        has = has if there is None else f"has {', '.join(there)}"
        key = step[1:] if step.startswith(".") else _place(step)
        return RobotError(f"{self.path}: {one.name!r}: there is no {key!r} in a message, which {has}")


_ABSENT: Final = object()


def _parse(path: Path, name: str, topics: Sequence[str]) -> _Field:
    """Divide a name into its topic, the longest that fits, and the path of its field."""
    place = columns.split_name(name, topics)
    if place is None and not any(name.startswith((f"{one}.", f"{one}[")) for one in topics):
        raise columns.missing_column(path, name.partition(".")[0], topics)
    if place is None or not place[1]:
        raise RobotError(
            f"{path}: {name!r} is no field; write a topic and a field, such as /joints.position[0]"
        )
    return _Field(name, *place)


def _place(step: str) -> Place:
    inner = step[1:-1].strip()
    return int(inner) if inner.isdecimal() else inner


def _step(content: Any, step: str, names: Sequence[str]) -> Any:
    """Return a field or an item; _ABSENT if there is none."""
    if step.startswith("."):
        if isinstance(content, Mapping):
            return content.get(step[1:], _ABSENT)
        return getattr(content, step[1:], _ABSENT) if is_dataclass(content) else _ABSENT
    place = columns.place_in_list(step, names)
    return content[place] if _is_list(content) and place is not None and place < len(content) else _ABSENT


def _fields_of(content: Any) -> Mapping[str, Any] | None:
    """Return the fields of a record by name; None for anything else."""
    if isinstance(content, Mapping):
        return content
    if is_dataclass(content):  # __dataclass_fields__ is ten times as fast as fields()
        return {name: getattr(content, name) for name in content.__dataclass_fields__ if name[0] != "_"}
    return None


def _names_of(content: Any) -> Sequence[str]:
    """Return the names that a record gives to the items of its lists."""
    for key in NAME_FIELDS:
        names = content.get(key) if isinstance(content, Mapping) else getattr(content, key, None)
        if isinstance(names, list) and names and isinstance(names[0], str):
            return names
    return ()


def _is_list(content: Any) -> bool:
    return isinstance(content, list | tuple | np.ndarray)


def _seconds(value: Any) -> tuple[Any, Any] | None:
    """Return seconds and nanoseconds of a stamp; None for anything else."""
    there = _fields_of(value)
    if there is None:
        return None
    sec = next((there[key] for key in SECONDS if key in there), None)
    has_sec = any(key in there for key in SECONDS)
    return (sec, next((there[key] for key in NANOSECONDS if key in there), 0)) if has_sec else None


def _kind(value: Any) -> columns.Kind:
    if isinstance(value, bool | np.bool_):
        return "flag"
    if isinstance(value, int | float | np.number) or value is None:
        return "number"
    if _seconds(value) is not None:
        return "time"
    return "text" if isinstance(value, str) else "other"


def _number(path: Path, name: str, value: Any) -> float:
    """Return a value as a number, a stamp as seconds; null is none."""
    stamp = _seconds(value)
    if stamp is not None:
        return _number(path, name, stamp[0]) + 1e-9 * _number(path, name, stamp[1])
    if value is None:
        return math.nan
    if not isinstance(value, int | float | np.number | np.bool_):
        raise RobotError(f"{path}: {name!r} has {type(value).__name__}; name a number in it")
    try:
        return float(value)
    except OverflowError:  # an integer of hundreds of digits
        return math.inf
