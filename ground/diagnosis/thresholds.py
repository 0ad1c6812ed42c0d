"""How surprising a finding must be: found from simulated cases of this very campaign, before data.

Cases without effect set when an effect may be claimed at all. Cases of one effect and of two, raced with all
hypotheses, set when what remains after the best model means that the cause is not among them. Those, and
cases of one effect that was taken out of the catalogue, teach when a name may be trusted.

Of those taken out only strangers teach. Where viscous friction is left out, Coulomb friction of the joint
passes for it, and nothing in the data can tell; what is in no catalogue has no such next of kin there.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.case import reduced
from ground.diagnosis.detect import Detectability
from ground.diagnosis.drawn import Drawn, Seen, drawable, one_of, sized
from ground.diagnosis.layout import Ints
from ground.diagnosis.model import fitted
from ground.diagnosis.prepared import Prepared
from ground.diagnosis.race import Field, best_left, race
from ground.diagnosis.structure import Group, remains
from ground.diagnosis.trust import Signs, Trust, learnt, signs_of

CASES: Final = 400
"""Of each kind."""
FALSE_ALARM: Final = 0.04
"""Share of no-effect cases in which anything may be claimed: below 5 % by one sigma of what CASES tell."""
DISOWNED: Final = 0.02
"""Share of cases of the right model that may be given up for what remains."""
WRONG: Final = 0.13
"""Share of strangers that may be given a wrong name."""
KIN: Final = 0.8
"""|cos| from which on an effect is no stranger to another: that explains two thirds of what it shows."""


@dataclass(frozen=True, slots=True)
class Thresholds:
    """In -log10 of a probability, with the rates that they had on simulated cases."""

    effect: float
    """A hypothesis must be as surprising as this."""
    structure: float
    """Without any effect chosen: what remains is structure from here on."""
    unexplained: float
    """With effects chosen: what remains is not explained by them from here on."""
    trust: Trust
    """Whether a name may be given otherwise."""
    false_alarm: float
    """Share of no-effect cases called an effect or unknown."""
    disowned: float
    """Share of cases in which the right effects were chosen that were called unknown."""
    wrong: float
    """Share of cases of one stranger given a name; NaN if there are none, or nothing to be named."""
    cases: int
    """Simulated, of each kind but strangers."""
    strangers: int
    """Simulated; all that were taken out where none is a stranger."""


Labels = set[int | None]
"""Classes of the effects of a simulated case that may be chosen."""


@dataclass(frozen=True, slots=True)
class _Won:
    """One simulated case in which something was chosen."""

    signs: Signs
    right: bool
    left_out: bool

    @property
    def remaining(self) -> float:
        """The most surprising of what remains."""
        return max(self.signs.remains, self.signs.addable)


def calibrate(
    prepared: Prepared,
    label: Ints,
    cosine: Array,
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
        step(index + 1, 2 * cases)
    effect, structure = _joint(found)
    field = Field(prepared, label, effect, none.inside)
    won: list[_Won] = []
    strangers: list[tuple[Field, Array]] = []
    kin: list[tuple[Field, Array]] = []
    known = _seen(field, limits)
    for index in range(cases if known else 0):
        one = sized(one_of(known, rng), rng)
        others = [other for other in known if other.label != one.seen.label] or known
        two = sized(one_of(others, rng), rng)
        y = _simulated(prepared, rng, _size(prepared, one))
        both = _simulated(prepared, rng, _size(prepared, one) + _size(prepared, two))
        won += _after(field, cosine, looked, y, {one.seen.label})
        won += _after(field, cosine, looked, both, {one.seen.label, two.seen.label})
        left = _left_out(field, one.seen)
        if left.inside.any():
            same = strangers if _is_stranger(left, cosine, one.seen) else kin
            same.append((left, y))
        step(cases + index + 1, 2 * cases)
    left_out = strangers or kin
    won += [one for left, y in left_out for one in _after(left, cosine, looked, y, set())]
    return _thresholds(found, effect, structure, won, len(left_out))


def _thresholds(found: Array, effect: float, structure: float, won: list[_Won], strangers: int) -> Thresholds:
    """Of no-effect cases (n, 2), and of those in which something was chosen, so many raced as strangers."""
    cases, right = len(found), [one.remaining for one in won if one.right]
    unexplained = float(np.quantile(right, 1.0 - DISOWNED)) if right else np.inf
    plain = [one for one in won if one.remaining < unexplained]
    trust = learnt(
        [one.signs for one in plain],
        np.array([one.right for one in plain]),
        np.array([one.left_out for one in plain]),
        int(WRONG * strangers),
    )
    named = [one for one in plain if trust.allows(one.signs)]
    return Thresholds(
        effect, structure, unexplained, trust,
        float(np.mean((found[:, 0] >= effect) | (found[:, 1] >= structure))),
        1.0 - sum(one.right for one in named) / max(len(right), 1),
        sum(one.left_out for one in named) / strangers if strangers else float("nan"),
        cases,
        strangers,
    )  # fmt: skip


def _seen(field: Field, limits: tuple[Detectability, ...]) -> list[Seen]:
    """All that may be chosen and that its bounds leave room for."""
    all_seen = [
        Seen(field.prepared.hypotheses[h], limits[h].limit, int(field.label[h]))
        for h in np.flatnonzero(field.inside)
    ]
    return [one for one in all_seen if drawable(one)]


def _simulated(prepared: Prepared, rng: np.random.Generator, t: Array) -> Array:
    """Whitened features of a case of sizes t (K,) in standard errors, (m,)."""
    v = np.where(prepared.prior == 1.0, rng.standard_normal(prepared.q), 0.0)
    return np.asarray(prepared.A @ np.concatenate([v, t]) + rng.standard_normal(prepared.layout.size))


def _size(prepared: Prepared, one: Drawn) -> Array:
    """What was drawn as sizes (K,)."""
    own = prepared.owner == prepared.hypotheses.index(one.seen.hypothesis)
    t = np.zeros(prepared.owner.size)
    t[own] = one.seen.hypothesis.departures(one.values) * prepared.scale[own]
    return t


def _nothing_chosen(field: Field, looked: tuple[Group, ...], y: Array) -> tuple[float, float]:
    """Surprise of the best hypothesis, and of what remains without any."""
    case = reduced(field.prepared, y)
    model = fitted(field.prepared, case, field.prepared.columns(()))
    return best_left(field, case, ()), remains(field.prepared, looked, model, y)[0].surprise


def _after(
    field: Field, cosine: Array, looked: tuple[Group, ...], y: Array, true: set[int | None]
) -> list[_Won]:
    """What was chosen and whether it is right, by class; nothing if none was. No truth: it was left out."""
    case = reduced(field.prepared, y)
    won = race(field, case)
    if not won.chosen:
        return []
    model = fitted(field.prepared, case, field.prepared.columns(won.chosen))
    left = remains(field.prepared, looked, model, y)[0].surprise
    signs = signs_of(field, cosine, case, won.chosen, won.shares, left)
    right = {int(field.label[h]) for h in won.chosen} <= true
    return [_Won(signs, right, not true)]


def _left_out(field: Field, one: Seen) -> Field:
    """The same without an effect, at all places, and without what is of its class."""
    same: Flags = np.array([other.effect == one.hypothesis.effect for other in field.prepared.hypotheses])
    return replace(field, inside=field.inside & ~same & (field.label != one.label))


def _is_stranger(left: Field, cosine: Array, one: Seen) -> bool:
    """Whether nothing that is left is like it; those of another number of parameters are like none."""
    return bool(cosine[left.prepared.hypotheses.index(one.hypothesis), left.inside].max() < KIN)


def _joint(found: Array) -> tuple[float, float]:
    """Thresholds at one quantile of both, so that FALSE_ALARM of the cases reach either."""
    low, high = 1.0 - FALSE_ALARM, 1.0
    for _ in range(30):
        middle = (low + high) / 2.0
        limit = np.quantile(found, middle, axis=0)
        low, high = (low, middle) if np.mean(np.any(found > limit, axis=1)) <= FALSE_ALARM else (middle, high)
    effect, structure = np.nextafter(np.quantile(found, high, axis=0), np.inf)
    return float(effect), float(structure)
