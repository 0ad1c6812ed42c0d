"""The arms that can be simulated, by name: what they are made of and what flight software believes."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from fsw.dictionary.params import Params
from sim.effects.built import as_built, left_by_calibration
from sim.effects.effect import Effect, knowing
from sim.params import nominal_params


class UnknownArm(ValueError):
    """A name that is not an arm."""


@dataclass(frozen=True, slots=True)
class BuiltArm:
    """An arm: the effects that make it differ from the drawing, and the flight parameters that go with it."""

    name: str
    effects: tuple[Effect, ...]
    params: Params

    def with_effects(self, effects: Iterable[Effect]) -> "BuiltArm":
        """The same arm with more effects, as far as it has them when its joints look for their hardstops."""
        return replace(self, effects=(*self.effects, *(effect for effect in effects if effect.of_the_arm)))


def later(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Those that no arm is built with: it has them only once a run begins."""
    return tuple(effect for effect in effects if not effect.of_the_arm)


def arm_named(name: str, params: Params | None = None) -> BuiltArm:
    """`nominal`, `as-built:SEED` or `calibrated:SEED`; UnknownArm otherwise.

    `params` replaces the nominal flight parameters; an arm of either kind is built from its seed alone.
    """
    believed = params or nominal_params()
    if name == "nominal":
        return BuiltArm(name, (), believed)
    match = re.fullmatch(r"(as-built|calibrated):([0-9]{1,9})", name)
    if match is None:
        raise UnknownArm(f"arm {name!r} is not known; write nominal, as-built:SEED or calibrated:SEED")
    seed = int(match[2])
    effects = as_built(seed)
    if match[1] == "calibrated":
        believed = knowing((*effects, *left_by_calibration(seed)), believed)
    return BuiltArm(name, effects, replace(believed, arm_name=name))
