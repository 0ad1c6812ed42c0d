"""All effects there are, found by looking through this folder, and every hypothesis that they make."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType
from typing import Any

import sim.effects
from sim.effects import effect as bases
from sim.effects.describe import Parameter, all_places, name_of, parameters_of, place_named
from sim.effects.effect import Effect


@cache
def catalogue() -> Mapping[str, type[Effect]]:
    """Every effect's class by its name, in the order of files and of classes in them."""
    found: dict[str, type[Effect]] = {}
    for module in iter_modules(sim.effects.__path__):
        path = f"{sim.effects.__name__}.{module.name}"
        if path != bases.__name__:
            found |= {name_of(kind): kind for kind in effects_in(import_module(path))}
    return MappingProxyType(found)


def effects_in(module: Any) -> Iterator[type[Effect]]:
    """The effects that a module defines, but those that it keeps to itself."""
    for name, kind in vars(module).items():
        is_effect = isinstance(kind, type) and issubclass(kind, Effect)
        if is_effect and kind.__module__ == module.__name__ and not name.startswith("_"):
            yield kind


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """An effect at a place, its size open."""

    kind: type[Effect]
    place: tuple[tuple[str, Any], ...]
    """Fields and values."""

    def __str__(self) -> str:
        return ":".join(
            part for part in (name_of(self.kind), place_named(self.kind, dict(self.place))) if part
        )

    @property
    def sizes(self) -> tuple[Parameter, ...]:
        """The parameters at whose neutral values nothing is changed."""
        return tuple(p for p in parameters_of(self.kind) if p.is_sized)

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """The other parameters; each has a default."""
        return tuple(p for p in parameters_of(self.kind) if not p.is_sized)

    def effect(self, **values: float) -> Effect:
        """With these parameters; sizes that are not given are neutral, shapes as they are by default."""
        neutral = {p.field: p.size.neutral for p in self.sizes if p.size is not None}
        return self.kind(**dict(self.place), **(neutral | values))

    def typical(self, times: float = 1.0) -> Effect:
        """With all sizes so many times as far from neutral as is typical."""
        return self.effect(**{p.field: departed(p, times) for p in self.sizes})


def departed(parameter: Parameter, times: float) -> float:
    """The value of a sized parameter so many typical departures from neutral."""
    size = parameter.size
    if size is None or size.neutral is None:
        raise ValueError(f"{parameter.field} has no neutral value")
    return size.neutral + times * size.typical


def hypotheses(kinds: Mapping[str, type[Effect]] | None = None) -> Iterator[Hypothesis]:
    """Every effect at every place, of these or of the catalogue, whose size is all that is open.

    That is one whose parameters all have neutral or default values, one at least a neutral one.
    """
    for kind in (catalogue() if kinds is None else kinds).values():
        parameters = parameters_of(kind)
        is_open = all(p.is_sized or p.default is not None for p in parameters)
        if is_open and any(p.is_sized for p in parameters):
            yield from (Hypothesis(kind, tuple(place.items())) for place in all_places(kind))
