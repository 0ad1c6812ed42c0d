"""How surprising a finding must be: found from simulated cases of this very campaign, before data.

Cases without effect set when an effect may be claimed at all. Cases of one effect, raced with all
hypotheses, and raced with that effect taken out of the catalogue, set when what remains after the best model
means that the cause is not among the hypotheses.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.gap.case import reduced
from ground.gap.detect import Detectability
from ground.gap.layout import Ints
from ground.gap.model import fitted
from ground.gap.prepared import Prepared
from ground.gap.race import Field, best_left, race
from ground.gap.structure import Group, remains

CASES: Final = 400
"""Of each kind."""
FALSE_ALARM: Final = 0.04
"""Share of no-effect cases in which anything may be claimed: below 5 % by one sigma of what CASES tell."""
DISOWNED: Final = 0.1
"""Share of cases of the right model in which it may be given up for unknown, at most."""
WRONG: Final = 0.12
"""Share of left-out effects that may be given a wrong name."""
SIZES: Final = (1.0, 4.0)
"""Of the effects drawn, in detection limits."""
INSIDE: Final = 0.9
"""Share of the way to its bounds that a size drawn may go."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """In -log10 of a probability, with the rates that they had on simulated cases."""

    effect: float
    """A hypothesis must be more surprising than this."""
    structure: float
    """Without any effect chosen: what remains is structure from here on."""
    unexplained: float
    """With effects chosen: what remains is not explained by them from here on."""
    false_alarm: float
    """Share of no-effect cases called an effect or unknown."""
    disowned: float
    """Share of cases of one known effect called unknown."""
    wrong: float
    """Share of cases of one left-out effect given a name."""
    cases: int
    """Simulated, of each kind."""


def calibrate(
    prepared: Prepared,
    label: Ints,
    limits: tuple[Detectability, ...],
    looked: tuple[Group, ...],
    seed: int,
    cases: int = CASES,
    step: Callable[[int, int], None] = lambda *_: None,
) -> Thresholds:
    """From `cases` simulated cases of each kind; `step(done, of)` is told how far it is."""
    rng = np.random.default_rng(seed)
    visible = np.array([limit.limit for limit in limits]) < np.inf
    none = Field(prepared, label, 0.0, visible & prepared.seen)
    found = np.empty((cases, 2))
    for index in range(cases):
        y = _simulated(prepared, rng, np.zeros(prepared.owner.size))
        found[index] = _nothing_chosen(none, looked, y)
        step(index + 1, 3 * cases)
    effect, structure = _joint(found)
    field = Field(prepared, label, effect, none.inside)
    able = np.flatnonzero(none.inside)
    with_it, without = np.empty(cases), np.empty(cases)
    for index in range(cases):
        one = int(rng.choice(able)) if able.size else 0
        y = _simulated(prepared, rng, _size(prepared, one, limits[one].limit, rng))
        with_it[index] = _after(field, looked, y, structure)
        without[index] = _after(_left_out(field, one), looked, y, structure)
        step(cases + 2 * (index + 1), 3 * cases)
    least = float(np.quantile(with_it, 1.0 - DISOWNED))
    named = without[without >= 0.0]
    allowed = np.sort(named)[min(int(WRONG * cases), named.size - 1)] if named.size else np.inf
    unexplained = float(max(least, min(structure, allowed)))
    return Thresholds(
        effect, structure, unexplained,
        float(np.mean((found[:, 0] >= effect) | (found[:, 1] >= structure))),
        float(np.mean(with_it >= unexplained)),
        float(np.mean((without >= 0.0) & (without < unexplained))),
        cases,
    )  # fmt: skip


def _simulated(prepared: Prepared, rng: np.random.Generator, t: Array) -> Array:
    """Whitened features of a case of sizes t (K,) in standard errors, (m,)."""
    v = np.where(prepared.prior == 1.0, rng.standard_normal(prepared.q), 0.0)
    return np.asarray(prepared.A @ np.concatenate([v, t]) + rng.standard_normal(prepared.layout.size))


def _size(prepared: Prepared, one: int, limit: float, rng: np.random.Generator) -> Array:
    """One hypothesis at a size among SIZES, uniform in its logarithm, within its bounds, as sizes (K,)."""
    times = limit * np.exp(rng.uniform(*np.log(SIZES)))
    typical = np.where(prepared.owner == one, prepared.scale, 0.0)
    signed = prepared.bounds[0, prepared.owner == one] < 0.0
    t = times * typical * (rng.choice([-1.0, 1.0]) if signed.all() else 1.0)
    return np.asarray(np.clip(t, INSIDE * prepared.bounds[0], INSIDE * prepared.bounds[1]))


def _nothing_chosen(field: Field, looked: tuple[Group, ...], y: Array) -> tuple[float, float]:
    """Surprise of the best hypothesis, and of what remains without any."""
    case = reduced(field.prepared, y)
    model = fitted(field.prepared, case, field.prepared.columns(()))
    return best_left(field, case, ()), remains(field.prepared, looked, model, y)[0].surprise


def _after(field: Field, looked: tuple[Group, ...], y: Array, structure: float) -> float:
    """What remains after the best model; -1 where none is chosen and no name can be wrong."""
    case = reduced(field.prepared, y)
    won = race(field, case)
    if not won.chosen:
        return -1.0
    return unexplained(field, looked, won.chosen, y)


def unexplained(field: Field, looked: tuple[Group, ...], chosen: tuple[int, ...], y: Array) -> float:
    """The most surprising of what remains after a model: a group, or a hypothesis that is not in it."""
    case = reduced(field.prepared, y)
    model = fitted(field.prepared, case, field.prepared.columns(chosen))
    return max(remains(field.prepared, looked, model, y)[0].surprise, best_left(field, case, chosen))


def _left_out(field: Field, one: int) -> Field:
    """The same without the effect of one hypothesis, at all places, and without what is of its class."""
    effect = field.prepared.hypotheses[one].effect
    same: Flags = np.array([hypothesis.effect == effect for hypothesis in field.prepared.hypotheses])
    return Field(
        field.prepared, field.label, field.threshold, field.inside & ~same & (field.label != field.label[one])
    )


def _joint(found: Array) -> tuple[float, float]:
    """Thresholds at one quantile of both, so that FALSE_ALARM of the cases reach either."""
    low, high = 1.0 - FALSE_ALARM, 1.0
    for _ in range(30):
        middle = (low + high) / 2.0
        limit = np.quantile(found, middle, axis=0)
        low, high = (low, middle) if np.mean(np.any(found > limit, axis=1)) <= FALSE_ALARM else (middle, high)
    effect, structure = np.nextafter(np.quantile(found, high, axis=0), np.inf)
    return float(effect), float(structure)
