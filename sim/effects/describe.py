"""What an effect's class says of it: its name, where it can sit, and its parameters."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from enum import IntEnum
from itertools import product
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from sim.effects.effect import EachCycle, EachMove, Effect, Timed
from sim.effects.size import Size


@dataclass(frozen=True, slots=True)
class Where:
    """A field that says where an effect sits."""

    field: str
    members: Mapping[str, Any]
    """What it may be, by name."""
    optional: bool


@dataclass(frozen=True, slots=True)
class Parameter:
    """A field that says how large an effect is, or of which shape."""

    field: str
    size: Size | None
    """None if the field says nothing of it."""
    count: int
    """Of numbers."""
    default: Any
    """None if it must be given."""

    @property
    def is_sized(self) -> bool:
        """Whether it is one number with a value at which nothing is changed."""
        return self.count == 1 and self.size is not None and self.size.neutral is not None


def name_of(kind: type[Effect]) -> str:
    """What the command line calls it: CoulombFriction is coulomb-friction."""
    return re.sub(r"(?<!^)(?=[A-Z])", "-", kind.__name__).lower()


def sentence_of(kind: type[Effect]) -> str:
    """The first sentence of what is written of it."""
    return " ".join((kind.__doc__ or "").split("\n\n")[0].split())


def when_of(kind: type[Effect]) -> str:
    """When it acts."""
    for base, words in ((Timed, "from a moment on"), (EachMove, "each move"), (EachCycle, "each cycle")):
        if issubclass(kind, base):
            return words
    return "always"


def flight_knows(kind: type[Effect]) -> bool:
    """Whether flight parameters have a word for it."""
    return kind.on_params is not Effect.on_params


def places_of(kind: type[Effect]) -> tuple[Where, ...]:
    """The fields of a joint, a frame, a tool or a literal."""
    hints = get_type_hints(kind)
    found = []
    for field in fields(kind):
        hint = hints[field.name]
        optional = get_origin(hint) in (UnionType, Union)
        members = _members(get_args(hint)[0] if optional else hint)
        if members:
            found.append(Where(field.name, members, optional))
    return tuple(found)


def parameters_of(kind: type[Effect]) -> tuple[Parameter, ...]:
    """The other fields."""
    hints, places = get_type_hints(kind, include_extras=True), {place.field for place in places_of(kind)}
    found = []
    for field in fields(kind):
        if field.name not in places:
            marks = getattr(hints[field.name], "__metadata__", ())
            size = next((mark for mark in marks if isinstance(mark, Size)), None)
            plain = hints[field.name]
            while get_origin(plain) is Annotated:
                plain = get_args(plain)[0]
            count = len(get_args(plain)) if get_origin(plain) is tuple else 1
            default = None if field.default is MISSING else field.default
            found.append(Parameter(field.name, size, count, default))
    return tuple(found)


def all_places(kind: type[Effect]) -> Iterator[dict[str, Any]]:
    """Every place at which an effect can sit, as its fields; what its class refuses is none."""
    known = places_of(kind)
    choices = [[*([None] if place.optional else []), *place.members.values()] for place in known]
    values = {p.field: _neutral(p) for p in parameters_of(kind)}
    for chosen in product(*choices):
        place = {where.field: value for where, value in zip(known, chosen, strict=True)}
        try:
            kind(**place, **values)
        except ValueError:
            continue
        yield place


def place_named(kind: type[Effect], place: Mapping[str, Any]) -> str:
    """A place in words: arm3.z."""
    words = []
    for where in places_of(kind):
        value = place[where.field]
        if value is not None:
            words.append(next(name for name, member in where.members.items() if member == value))
    return ".".join(words)


def _neutral(parameter: Parameter) -> Any:
    if parameter.size is None or parameter.size.neutral is None:
        default = parameter.default
        return parameter.size.typical if default is None and parameter.size is not None else default
    neutral = parameter.size.neutral
    return neutral if parameter.count == 1 else (neutral,) * parameter.count


def _members(hint: Any) -> dict[str, Any]:
    if isinstance(hint, type) and issubclass(hint, IntEnum):
        return {member.name.lower(): member for member in hint}
    return {word: word for word in get_args(hint)} if get_origin(hint) is Literal else {}
