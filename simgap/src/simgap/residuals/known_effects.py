"""Residuals about effects that are known, such as those of an earlier diagnosis, and changes of these."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from simgap.arrays import Array
from simgap.effects.effect import Effect, Size
from simgap.effects.variation import Dependent
from simgap.residuals.residuals import (
    ResidualModel,
    WrappedResiduals,
    add_sizes,
    refer_to,
    residuals_by_motion,
    split_sizes,
)


@dataclass(frozen=True)
class Change(Dependent):
    """Change of the sizes of another effect from those that are known."""

    known: tuple[float, ...]
    """Known sizes, from which bounds follow."""

    @property
    def name(self) -> str:
        """Name of the effect that changes."""
        return f"change of {self.effect_name}"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Return differences of sizes, which may have either sign."""
        return tuple(
            replace(one, low=one.low - at, high=one.high - at, prior_std=math.inf)
            for one, at in zip(self.effect.sizes, self.known, strict=True)
        )

    def describe(self, size: Array) -> str:
        """Return the changes with their signs, and what they start from."""
        parts = zip(self.effect.sizes, size, self.known, strict=True)
        return ", ".join(f"{one.name} {value:+.4g} from {at:.4g}" for one, value, at in parts)


def changes_of(known: Mapping[Effect, Array]) -> list[Change]:
    """Return the changes that known effects may have from their sizes, (n_sizes,) each."""
    return [Change(one.place, one, tuple(size.tolist())) for one, size in known.items()]


class KnownResiduals(WrappedResiduals):
    """Residuals about a model with known effects, from whose sizes all others count; see `ResidualModel`."""

    def __init__(self, raw: ResidualModel, known: Mapping[Effect, Array]) -> None:
        """Keep the residuals, and known effects with their sizes, (n_sizes,) each."""
        super().__init__(raw)
        self.by_motion = True
        self.known = dict(known)

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, (n_candidates, n)."""
        return residuals_by_motion(self.raw, *self._add_known(effects, sizes))

    def _add_known(self, effects: Sequence[Effect], sizes: Array) -> tuple[list[Effect], Array]:
        """Return all effects and their sizes, (n_candidates, [n_motions,] total sizes), within bounds."""
        terms = [*self.known.items()]
        terms += [
            (one.effect if isinstance(one, Change) else one, own) for one, own in split_sizes(effects, sizes)
        ]
        return add_sizes(terms, sizes.shape[:-1])

    def around(self, effects: Sequence[Effect], sizes: Array) -> "KnownResiduals":
        """Return the residuals with another reference: effects with their sizes, (1, total sizes)."""
        inner, total = self._add_known(effects, sizes)
        return KnownResiduals(refer_to(self.raw, inner, total[0]), self.known)

    def select(self, motions: Sequence[str]) -> "KnownResiduals":
        """Return the residuals of these motions alone, in their old order."""
        return KnownResiduals(self.raw.select(motions), self.known)
