"""Catalogue of effects: their names, places, parameters and hypotheses.

The effects are found in the modules of this folder.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from enum import IntEnum
from functools import cache
from importlib import import_module
from itertools import product
from pkgutil import iter_modules
from types import MappingProxyType, UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import sim.effects
from fsw.dictionary.types import NameMark
from sim.arms import nominal_params
from sim.effects import effect as bases
from sim.effects.effect import EachCycle, EachMove, Effect, ParameterSpec, Timed

ORDER: Final = (
    *("flex-cable", "counterbalance", "contact-stiffness", "surface-position", "ambient"),
    *("structure-temperature", "current-noise", "power-loss", "nothing-to-touch", "sensor-fault"),
    *("joint-seized", "brake-stuck", "weak-motor", "hot-motor", "missed-cycles", "tilt-step", "rock-gone"),
    *("coulomb-friction", "asymmetric-friction", "viscous-friction", "stribeck-friction", "load-friction"),
    *("cold-friction", "output-friction", "gear-hysteresis", "gear-efficiency", "transmission-error"),
    *("joint-coupling", "frame-error", "expansion", "link-warming", "warming", "hardstop-angle"),
    *("hardstop-stiffness", "resolver-bias", "backlash-width", "gear-stiffness", "gear-friction"),
    *("link-length", "link-angle", "tool-offset", "tool-turn", "thermal-gradient", "motor-constant"),
    *("servo-gain", "command-delay", "bus-sag", "frame-play", "windup", "servo-error", "numerics"),
    *("current-gain", "current-bias", "current-crosstalk", "encoder-scale", "encoder-zero"),
    *("counter-start", "resolver-eccentricity", "resolver-scale", "gravity-direction", "structure-sensor"),
    *("link-stiffness", "link-torsion", "link-bending", "link-creep", "rover-compliance", "link-mass"),
    *("stand-in-turret", "turret-mass", "turret-centre"),
)
"""Order of the effects, from which sealed cases are drawn; a new effect comes last, in the order of files."""


@dataclass(frozen=True, slots=True)
class PlaceField:
    """Field of an effect that names its place."""

    field: str
    members: Mapping[str, Any]
    """Possible values, by name."""
    optional: bool


@dataclass(frozen=True, slots=True)
class ParameterField:
    """Field of an effect that is an amplitude or a shape parameter."""

    field: str
    spec: ParameterSpec | None
    """None if the field declares no ParameterSpec."""
    count: int
    """Number of elements."""
    default: Any
    """None if the parameter must be given."""

    @property
    def is_amplitude(self) -> bool:
        """Return whether this is one number with a neutral value."""
        return self.count == 1 and self.spec is not None and self.spec.neutral is not None


def effect_name(kind: type[Effect]) -> str:
    """Return the name of an effect on the command line: CoulombFriction is coulomb-friction."""
    return re.sub(r"(?<!^)(?=[A-Z])", "-", kind.__name__).lower()


def effect_summary(kind: type[Effect]) -> str:
    """Return the summary of the docstring of an effect."""
    return " ".join((kind.__doc__ or "").split("\n\n")[0].split())


def effect_timing(kind: type[Effect]) -> str:
    """Return in words when an effect acts."""
    for base, words in ((Timed, "from a moment on"), (EachMove, "each move"), (EachCycle, "each cycle")):
        if issubclass(kind, base):
            return words
    return "always"


def has_flight_parameter(kind: type[Effect]) -> bool:
    """Return whether a flight parameter describes this effect."""
    return kind.on_params is not Effect.on_params


def place_fields_of(kind: type[Effect], tools: Sequence[str] | None = None) -> tuple[PlaceField, ...]:
    """List the fields of an effect that are a joint, a frame, a tool (None: default ones) or a literal."""
    hints = get_type_hints(kind, include_extras=True)
    found = []
    for field in fields(kind):
        hint = hints[field.name]
        optional = get_origin(hint) in (UnionType, Union)
        members = _choices_of(get_args(hint)[0] if optional else hint, tools)
        if members:
            found.append(PlaceField(field.name, members, optional))
    return tuple(found)


def parameters_of(kind: type[Effect]) -> tuple[ParameterField, ...]:
    """List the fields of an effect that are not its place."""
    hints = get_type_hints(kind, include_extras=True)
    places = {place.field for place in place_fields_of(kind)}
    found = []
    for field in fields(kind):
        if field.name not in places:
            marks = getattr(hints[field.name], "__metadata__", ())
            spec = next((mark for mark in marks if isinstance(mark, ParameterSpec)), None)
            hint = hints[field.name]
            while get_origin(hint) is Annotated:
                hint = get_args(hint)[0]
            count = len(get_args(hint)) if get_origin(hint) is tuple else 1
            default = None if field.default is MISSING else field.default
            found.append(ParameterField(field.name, spec, count, default))
    return tuple(found)


def all_places(kind: type[Effect], tools: Sequence[str] | None = None) -> Iterator[dict[str, Any]]:
    """Yield every place that an effect accepts, by field name; tools are the default ones for None."""
    place_fields = place_fields_of(kind, tools)
    choices = [[*([None] if field.optional else []), *field.members.values()] for field in place_fields]
    values = {p.field: _neutral_value(p) for p in parameters_of(kind)}
    for chosen in product(*choices):
        place = {field.field: value for field, value in zip(place_fields, chosen, strict=True)}
        try:
            kind(**place, **values)
        except ValueError:
            continue
        yield place


def effect_place_text(kind: type[Effect], place: Mapping[str, Any]) -> str:
    """Return a place as text: arm3.z."""
    words = []
    for field in place_fields_of(kind):
        value = place[field.field]
        if value is not None:
            words.append(place_word(field, value))
    return ".".join(words)


def place_word(field: PlaceField, value: Any) -> str:
    """Return the word for a value of a place: the name of a member, or that of a tool of any arm."""
    return next((name for name, member in field.members.items() if member == value), str(value))


def _neutral_value(parameter: ParameterField) -> Any:
    if parameter.spec is None or parameter.spec.neutral is None:
        default = parameter.default
        return parameter.spec.typical if default is None and parameter.spec is not None else default
    neutral = parameter.spec.neutral
    return neutral if parameter.count == 1 else (neutral,) * parameter.count


def _choices_of(hint: Any, tools: Sequence[str] | None) -> dict[str, Any]:
    if NameMark.TOOL in getattr(hint, "__metadata__", ()):
        return {tool: tool for tool in tools or nominal_params().tool_names}
    if isinstance(hint, type) and issubclass(hint, IntEnum):
        return {member.name.lower(): member for member in hint}
    return {word: word for word in get_args(hint)} if get_origin(hint) is Literal else {}


@cache
def catalogue() -> Mapping[str, type[Effect]]:
    """Return the class of every effect by its name."""
    found: dict[str, type[Effect]] = {}
    for module in iter_modules(sim.effects.__path__):
        path = f"{sim.effects.__name__}.{module.name}"
        if path != bases.__name__:
            found |= {effect_name(kind): kind for kind in effect_classes_in(import_module(path))}
    known = [name for name in ORDER if name in found]
    return MappingProxyType({name: found[name] for name in dict.fromkeys((*known, *found))})


def effect_classes_in(module: Any) -> Iterator[type[Effect]]:
    """List the public effects that a module defines."""
    for name, kind in vars(module).items():
        is_effect = isinstance(kind, type) and issubclass(kind, Effect)
        if is_effect and kind.__module__ == module.__name__ and not name.startswith("_"):
            yield kind


@dataclass(frozen=True, slots=True)
class EffectHypothesis:
    """Effect at a place, with free parameters."""

    kind: type[Effect]
    place: tuple[tuple[str, Any], ...]
    """Field names and values."""

    def __str__(self) -> str:
        return ":".join(
            part for part in (effect_name(self.kind), effect_place_text(self.kind, dict(self.place))) if part
        )

    @property
    def amplitudes(self) -> tuple[ParameterField, ...]:
        """Return the parameters that have a neutral value."""
        return tuple(p for p in parameters_of(self.kind) if p.is_amplitude)

    def effect(self, **values: float) -> Effect:
        """Make the effect with these parameters; others are neutral, or have their defaults."""
        neutral = {p.field: p.spec.neutral for p in self.amplitudes if p.spec is not None}
        return self.kind(**dict(self.place), **(neutral | values))

    def typical(self, times: float = 1.0) -> Effect:
        """Make the effect with each amplitude at `times` typical departures from neutral."""
        return self.effect(**{p.field: scaled_value(p, times) for p in self.amplitudes})


def scaled_value(parameter: ParameterField, times: float) -> float:
    """Return the value `times` typical departures from neutral; ValueError without a neutral value."""
    spec = parameter.spec
    if spec is None or spec.neutral is None:
        raise ValueError(f"{parameter.field} has no neutral value")
    return spec.neutral + times * spec.typical


def hypotheses(
    kinds: Mapping[str, type[Effect]] | None = None, tools: Sequence[str] | None = None
) -> Iterator[EffectHypothesis]:
    """List the hypotheses of these effects, or of the catalogue, at every place.

    Each parameter has a neutral or a default value, and at least one of them a neutral value.
    """
    for kind in (catalogue() if kinds is None else kinds).values():
        parameters = parameters_of(kind)
        is_open = all(p.is_amplitude or p.default is not None for p in parameters)
        if is_open and any(p.is_amplitude for p in parameters):
            yield from (EffectHypothesis(kind, tuple(place.items())) for place in all_places(kind, tools))
