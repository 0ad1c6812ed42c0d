"""Random effects of detectable size, for blind cases."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.problem import Hypothesis, Ints

LIMIT_MULTIPLES: Final = (0.5, 4.0)
"""Range of the sampled amplitudes, in detection limits."""
BOUND_SHARE: Final = 0.9
"""Share of the distance to its bounds that a sampled amplitude may use."""


@dataclass(frozen=True, slots=True)
class DetectableEffect:
    """Effect with its detection limit in typical sizes and its class; None for an out-of-catalogue effect."""

    hypothesis: Hypothesis
    limit: float
    label: int | None


@dataclass(frozen=True, slots=True, eq=False)
class SampledEffect:
    """Sampled effect: values of all its parameters, and its amplitude in detection limits."""

    source: DetectableEffect
    values: Array
    times_limit: float


def can_sample(one: DetectableEffect, multiples: tuple[float, float] = LIMIT_MULTIPLES) -> bool:
    """Check that the campaign detects the effect and that its bounds allow the smallest amplitude."""
    room = max(_room(one, sign) for sign in (-1, 1))
    return bool(np.isfinite(one.limit)) and room >= multiples[0] * one.limit


def sample_effect(some: Sequence[DetectableEffect], rng: np.random.Generator) -> DetectableEffect:
    """Sample an effect uniformly, then one of its places: many places do not make it more frequent."""
    names = sorted({one.hypothesis.effect for one in some})
    name = names[int(rng.integers(len(names)))]
    places = [one for one in some if one.hypothesis.effect == name]
    return places[int(rng.integers(len(places)))]


def sample_amplitude(
    one: DetectableEffect, rng: np.random.Generator, multiples: tuple[float, float] = LIMIT_MULTIPLES
) -> SampledEffect:
    """Sample an amplitude log-uniformly, with a random sign, within the bounds.

    All amplitude parameters depart from neutral by the same number of typical sizes.

    Args:
        one: Effect with its detection limit.
        multiples: Least and greatest amplitude in detection limits.
    """
    times = float(np.exp(rng.uniform(*np.log(multiples))))
    sign = int(rng.choice((-1, 1)))
    if _room(one, sign) < multiples[0] * one.limit:
        sign = -sign
    typical = min(times * one.limit, _room(one, sign))
    values = one.hypothesis.values(np.full(len(one.hypothesis.amplitudes), sign * typical))
    return SampledEffect(one, values, typical / one.limit)


def list_detectable(
    hypotheses: Sequence[Hypothesis], limits: Sequence[float], label: Ints
) -> list[DetectableEffect]:
    """List hypotheses with their detection limits in typical sizes and their equivalence classes."""
    rows = zip(hypotheses, limits, label, strict=True)
    return [DetectableEffect(one, limit, int(number)) for one, limit, number in rows]


def _room(one: DetectableEffect, sign: int) -> float:
    """Return how many typical sizes all amplitudes together may depart to one side."""
    ends = [parameter.departure_range for parameter in one.hypothesis.amplitudes]
    return BOUND_SHARE * min(most if sign > 0 else -least for least, most in ends)
