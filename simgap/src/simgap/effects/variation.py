"""Effects that act through another one: sizes that follow a number of the motions, or differ between sets."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect, JointEffect, Size


@dataclass(frozen=True)
class Dependent(Effect):
    """Sizes that are added to those of another effect; residuals call the hooks of that one."""

    place: str
    effect: Effect

    def __post_init__(self) -> None:
        """Take the form from the effect."""
        for key in ("has_shape", "is_steady"):
            object.__setattr__(self, key, getattr(self.effect, key))

    @property
    def effect_name(self) -> str:
        """Name of the other effect at this place."""
        return self.effect.key.removeprefix(f"{self.place}: ")

    @property
    def family(self) -> StrEnum:
        """Family of the other effect."""
        return self.effect.family

    @property
    def parts(self) -> tuple[Effect, ...]:
        """The same at the joints, where the other effect acts at each of them."""
        return tuple(replace(self, place=one.place, effect=one) for one in self.effect.parts)

    def overrides(self, *hooks: str) -> bool:
        """Return whether the other effect has its own version of any of these hooks."""
        return self.effect.overrides(*hooks)


@dataclass(frozen=True)
class Variation(Dependent):
    """Sizes of another effect that are added in proportion to a number of the motions."""

    number: str
    """Name of the number: a condition."""
    largest: float = 1.0
    """Largest magnitude of the number over all motions."""

    @property
    def name(self) -> str:
        """Name of the effect, and what varies it."""
        return f"{self.effect_name} by {self.number}"

    @property
    def n_scaled(self) -> int:
        """Number of the first sizes that are in proportion; the others give a form, and stay."""
        return 1 if self.effect.has_shape else len(self.effect.sizes)

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Return sizes for a number of 1; differences may have either sign.

        A fall may be larger than the number of the model, as the fitted one may be.
        """
        found = []
        for k, one in enumerate(self.effect.sizes):
            low = min(one.low, -one.high)
            unit = self.largest if k < self.n_scaled else 1.0
            found.append(Size(one.name, low / unit, one.high / unit, one.typical / unit))
        return tuple(found)

    def describe(self, size: Array) -> str:
        """Return the sizes with their signs."""
        text = ", ".join(f"{name} {value:+.4g}" for name, value in self.name_sizes(size).items())
        return f"{text} for 1 of {self.number}"


@dataclass(frozen=True)
class Difference(Variation):
    """Difference of an effect between two sets of motions: sizes that are added in one of them.

    The second set has a positive difference. So has it a negative one of an effect whose first size may be
    negative; else the first set has its amount, so that an effect may be gone that the sets do not share.
    """

    number: str = "set"

    @property
    def name(self) -> str:
        """Name of the effect that changes."""
        return f"change of {self.effect_name}"

    def describe(self, size: Array) -> str:
        """Return the differences with their signs."""
        return ", ".join(f"{name} {value:+.4g}" for name, value in self.name_sizes(size).items())

    def split(self, size: Array) -> tuple[Array, Array]:
        """Return what is added in the first and in the second set, (.., n_sizes) each."""
        is_first = (size[..., :1] < 0.0) & (self.effect.sizes[0].low == 0.0)
        signs = np.where(np.arange(size.shape[-1]) < self.n_scaled, -1.0, 1.0)
        return np.where(is_first, signs * size, 0.0), np.where(is_first, 0.0, size)


def steady_effect(effect: Effect) -> Effect:
    """Return the effect that varies; an effect that does not vary itself."""
    return effect.effect if isinstance(effect, Variation) else effect


def unbound(effect: Effect) -> Effect:
    """Return a base effect without its prior."""
    return replace(effect, is_base=False) if isinstance(effect, JointEffect) else effect
