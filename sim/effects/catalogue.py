"""The catalogue of effects: their names, places, parameters and hypotheses.

The effects are found in the modules of this folder.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from enum import IntEnum
from functools import cache
from importlib import import_module
from itertools import product
from pkgutil import iter_modules
from types import MappingProxyType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import sim.effects
from sim.effects import effect as bases
from sim.effects.effect import EachCycle, EachMove, Effect, ParameterSpec, Timed


@dataclass(frozen=True, slots=True)
class PlaceField:
    """A field that says where an effect sits."""

    field: str
    members: Mapping[str, Any]
    """What it may be, by name."""
    optional: bool


@dataclass(frozen=True, slots=True)
class ParameterField:
    """A field that says how large an effect is, or of which shape."""

    field: str
    spec: ParameterSpec | None
    """None if the field says nothing of it."""
    count: int
    """Of numbers."""
    default: Any
    """None if it must be given."""

    @property
    def is_amplitude(self) -> bool:
        """Whether it is one number with a value at which nothing is changed."""
        return self.count == 1 and self.spec is not None and self.spec.neutral is not None


def effect_name(kind: type[Effect]) -> str:
    """What the command line calls it: CoulombFriction is coulomb-friction."""
    return re.sub(r"(?<!^)(?=[A-Z])", "-", kind.__name__).lower()


def effect_summary(kind: type[Effect]) -> str:
    """The first sentence of what is written of it."""
    return " ".join((kind.__doc__ or "").split("\n\n")[0].split())


def effect_timing(kind: type[Effect]) -> str:
    """When it acts."""
    for base, words in ((Timed, "from a moment on"), (EachMove, "each move"), (EachCycle, "each cycle")):
        if issubclass(kind, base):
            return words
    return "always"


def has_flight_parameter(kind: type[Effect]) -> bool:
    """Whether flight parameters have a word for it."""
    return kind.on_params is not Effect.on_params


def place_fields_of(kind: type[Effect]) -> tuple[PlaceField, ...]:
    """The fields of a joint, a frame, a tool or a literal."""
    hints = get_type_hints(kind)
    found = []
    for field in fields(kind):
        hint = hints[field.name]
        optional = get_origin(hint) in (UnionType, Union)
        members = _choices_of(get_args(hint)[0] if optional else hint)
        if members:
            found.append(PlaceField(field.name, members, optional))
    return tuple(found)


def parameters_of(kind: type[Effect]) -> tuple[ParameterField, ...]:
    """The other fields."""
    hints, places = (
        get_type_hints(kind, include_extras=True),
        {place.field for place in place_fields_of(kind)},
    )
    found = []
    for field in fields(kind):
        if field.name not in places:
            marks = getattr(hints[field.name], "__metadata__", ())
            size = next((mark for mark in marks if isinstance(mark, ParameterSpec)), None)
            plain = hints[field.name]
            while get_origin(plain) is Annotated:
                plain = get_args(plain)[0]
            count = len(get_args(plain)) if get_origin(plain) is tuple else 1
            default = None if field.default is MISSING else field.default
            found.append(ParameterField(field.name, size, count, default))
    return tuple(found)


def all_places(kind: type[Effect]) -> Iterator[dict[str, Any]]:
    """Every place at which an effect can sit, as its fields; what its class refuses is none."""
    known = place_fields_of(kind)
    choices = [[*([None] if place.optional else []), *place.members.values()] for place in known]
    values = {p.field: _neutral_value(p) for p in parameters_of(kind)}
    for chosen in product(*choices):
        place = {where.field: value for where, value in zip(known, chosen, strict=True)}
        try:
            kind(**place, **values)
        except ValueError:
            continue
        yield place


def effect_place_text(kind: type[Effect], place: Mapping[str, Any]) -> str:
    """A place in words: arm3.z."""
    words = []
    for where in place_fields_of(kind):
        value = place[where.field]
        if value is not None:
            words.append(next(name for name, member in where.members.items() if member == value))
    return ".".join(words)


def _neutral_value(parameter: ParameterField) -> Any:
    if parameter.spec is None or parameter.spec.neutral is None:
        default = parameter.default
        return parameter.spec.typical if default is None and parameter.spec is not None else default
    neutral = parameter.spec.neutral
    return neutral if parameter.count == 1 else (neutral,) * parameter.count


def _choices_of(hint: Any) -> dict[str, Any]:
    if isinstance(hint, type) and issubclass(hint, IntEnum):
        return {member.name.lower(): member for member in hint}
    return {word: word for word in get_args(hint)} if get_origin(hint) is Literal else {}


@cache
def catalogue() -> Mapping[str, type[Effect]]:
    """Every effect's class by its name, in the order of files and of classes in them."""
    found: dict[str, type[Effect]] = {}
    for module in iter_modules(sim.effects.__path__):
        path = f"{sim.effects.__name__}.{module.name}"
        if path != bases.__name__:
            found |= {effect_name(kind): kind for kind in effect_classes_in(import_module(path))}
    return MappingProxyType(found)


def effect_classes_in(module: Any) -> Iterator[type[Effect]]:
    """The effects that a module defines, but those that it keeps to itself."""
    for name, kind in vars(module).items():
        is_effect = isinstance(kind, type) and issubclass(kind, Effect)
        if is_effect and kind.__module__ == module.__name__ and not name.startswith("_"):
            yield kind


@dataclass(frozen=True, slots=True)
class EffectHypothesis:
    """An effect at a place, its size open."""

    kind: type[Effect]
    place: tuple[tuple[str, Any], ...]
    """Fields and values."""

    def __str__(self) -> str:
        return ":".join(
            part for part in (effect_name(self.kind), effect_place_text(self.kind, dict(self.place))) if part
        )

    @property
    def amplitudes(self) -> tuple[ParameterField, ...]:
        """The parameters at whose neutral values nothing is changed."""
        return tuple(p for p in parameters_of(self.kind) if p.is_amplitude)

    @property
    def shape_parameters(self) -> tuple[ParameterField, ...]:
        """The other parameters; each has a default."""
        return tuple(p for p in parameters_of(self.kind) if not p.is_amplitude)

    def effect(self, **values: float) -> Effect:
        """With these parameters; sizes that are not given are neutral, shapes as they are by default."""
        neutral = {p.field: p.spec.neutral for p in self.amplitudes if p.spec is not None}
        return self.kind(**dict(self.place), **(neutral | values))

    def typical(self, times: float = 1.0) -> Effect:
        """With all sizes so many times as far from neutral as is typical."""
        return self.effect(**{p.field: scaled_value(p, times) for p in self.amplitudes})


def scaled_value(parameter: ParameterField, times: float) -> float:
    """The value of a sized parameter so many typical departures from neutral."""
    size = parameter.spec
    if size is None or size.neutral is None:
        raise ValueError(f"{parameter.field} has no neutral value")
    return size.neutral + times * size.typical


def hypotheses(kinds: Mapping[str, type[Effect]] | None = None) -> Iterator[EffectHypothesis]:
    """Every effect at every place, of these or of the catalogue, whose size is all that is open.

    That is one whose parameters all have neutral or default values, one at least a neutral one.
    """
    for kind in (catalogue() if kinds is None else kinds).values():
        parameters = parameters_of(kind)
        is_open = all(p.is_amplitude or p.default is not None for p in parameters)
        if is_open and any(p.is_amplitude for p in parameters):
            yield from (EffectHypothesis(kind, tuple(place.items())) for place in all_places(kind))
