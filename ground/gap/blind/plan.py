"""Which effects blind cases have, and how large: drawn from a seed before anything is recorded."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.blind.truth import Kind
from ground.gap.hypothesis import Hypothesis, Parameter
from ground.gap.thresholds import INSIDE, SIZES

SHARES: Final[dict[Kind, float]] = {"none": 0.3, "outside": 0.2, "pair": 0.2}
"""Of all cases; the others have one effect."""


@dataclass(frozen=True, slots=True)
class Seen:
    """An effect that can be drawn: its detection limit [typical sizes], and its class; none if outside."""

    hypothesis: Hypothesis
    limit: float
    label: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """One that was drawn, with the values of all its parameters, and its size over the limit."""

    seen: Seen
    values: Array
    times_limit: float


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A case."""

    kind: Kind
    effects: tuple[Drawn, ...]


def planned(
    cases: int, catalogue: Sequence[Seen], outside: Sequence[Seen], rng: np.random.Generator
) -> tuple[Planned, ...]:
    """So many cases, in a random order.

    Effects are drawn first, then the place of each; of a pair both are of different classes.
    """
    known, unknown = ([one for one in some if drawable(one)] for some in (catalogue, outside))
    counts = {kind: round(share * cases) for kind, share in SHARES.items()}
    kinds: list[Kind] = [kind for kind, count in counts.items() for _ in range(count)]
    kinds += ["single"] * (cases - len(kinds))
    return tuple(Planned(kinds[k], _effects(kinds[k], known, unknown, rng)) for k in rng.permutation(cases))


def drawable(one: Seen) -> bool:
    """Whether the campaign sees it, and its bounds leave room for the smallest size that is drawn."""
    return bool(np.isfinite(one.limit)) and max(_room(one, sign) for sign in (-1, 1)) >= SIZES[0] * one.limit


def _effects(
    kind: Kind, known: list[Seen], unknown: list[Seen], rng: np.random.Generator
) -> tuple[Drawn, ...]:
    if kind == "none":
        return ()
    first = _sized(_one_of(unknown if kind == "outside" else known, rng), rng)
    if kind != "pair":
        return (first,)
    others = [one for one in known if one.label != first.seen.label]
    return first, _sized(_one_of(others, rng), rng)


def _one_of(some: list[Seen], rng: np.random.Generator) -> Seen:
    names = sorted({one.hypothesis.effect for one in some})
    name = names[int(rng.integers(len(names)))]
    places = [one for one in some if one.hypothesis.effect == name]
    return places[int(rng.integers(len(places)))]


def _sized(one: Seen, rng: np.random.Generator) -> Drawn:
    """All its sizes so many typical ones from neutral, to one side; within the bounds."""
    times = float(np.exp(rng.uniform(*np.log(SIZES))))
    sign = int(rng.choice((-1, 1)))
    if _room(one, sign) < SIZES[0] * one.limit:
        sign = -sign
    typical = min(times * one.limit, _room(one, sign))
    values = np.array([p.absent + sign * typical * p.typical * p.sizes for p in one.hypothesis.parameters])
    return Drawn(one, values, typical / one.limit)


def _room(one: Seen, sign: int) -> float:
    """How many typical sizes all sizes together may go to one side."""
    return INSIDE * min(_way(parameter, sign) for parameter in one.hypothesis.sizes)


def _way(parameter: Parameter, sign: int) -> float:
    upwards = sign * parameter.typical > 0.0
    end = parameter.most if upwards else parameter.least
    return abs(end - parameter.absent) / abs(parameter.typical)
