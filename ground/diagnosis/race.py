"""Hypotheses raced: which one, two or three explain a case, and predict blocks they were not fitted to."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.case import Case
from ground.diagnosis.fits import drop, foretold, losses, sizes, surprise, within
from ground.diagnosis.layout import Ints
from ground.diagnosis.prepared import Prepared

MOST_EFFECTS: Final = 3
TOLD: Final = 0.1
"""Share of what effects explain that blocks must be able to foretell of each other to have a say."""

Chosen = tuple[int, ...]
"""Hypotheses, by index, in the order chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Those that race: a campaign, the class of every hypothesis, and how surprising a finding must be."""

    prepared: Prepared
    label: Ints
    """(H,)."""
    threshold: float
    """In -log10 of a probability (see `thresholds`)."""
    inside: Flags
    """Hypotheses that may be chosen, (H,)."""

    def standing_for(self, one: int) -> int:
        """The first hypothesis of its class."""
        return int(np.flatnonzero(self.label == self.label[one])[0])


@dataclass(frozen=True, slots=True, eq=False)
class Race:
    """Who won, and what else came near."""

    chosen: Chosen
    first: tuple[int, ...]
    """The best as a single hypothesis, best first: also where none is accepted."""
    surprise: float
    """Of the best single hypothesis, -log10 of its probability if there is no effect."""
    t: Array
    """Sizes of the chosen in standard errors, as `Prepared.columns` orders them."""
    dropped: float
    """Of the deviance, by all of the chosen."""
    shares: tuple[float, ...]
    """Of that, what is lost without each: the own shares; the rest is common to them."""


def race(field: Field, case: Case) -> Race:
    """Forward selection with exchange, to at most three effects, of which none may be left out.

    A hypothesis is added if it explains more than no-effect data do, unless with it held-out blocks are
    predicted worse by more than one standard error of the paired differences between blocks. They have a say
    only where they can foretell a share of it: not of what one block alone shows, nor of what is seen only
    because a nuisance would have to be beyond all that is known of it. Of hypotheses of one class only one
    may be chosen. A size at a bound is no finding.
    """
    chosen: Chosen = ()
    loss = np.zeros(case.c.shape[0])
    first, best = ranked(field, case, ())
    while len(chosen) < MOST_EFFECTS:
        longer = _better(field, case, chosen, loss)
        if longer is None:
            break
        chosen, loss = longer
    columns = field.prepared.columns(chosen)
    t = sizes(field.prepared, case, columns)
    dropped = float(t @ case.all[columns])
    return Race(chosen, first, best, t, dropped, _shares(field.prepared, case, chosen, dropped))


def surprise_of(field: Field, case: Case, chosen: Chosen) -> float:
    """Of all of them together: parameters count."""
    columns = field.prepared.columns(chosen)
    return float(surprise(drop(field.prepared, case, columns), columns.size))


def best_left(field: Field, case: Case, chosen: Chosen) -> float:
    """Surprise of the most surprising hypothesis that could be added to those chosen."""
    return ranked(field, case, chosen)[1]


def _better(field: Field, case: Case, chosen: Chosen, loss: Array) -> tuple[Chosen, Array] | None:
    """One more, after exchange; None if nothing more is found, or if one of so many is not needed."""
    order, best = ranked(field, case, chosen)
    if not order or best < field.threshold:
        return None
    longer = _exchanged(field, case, (*chosen, order[0]))
    after = _loss(field.prepared, case, longer)
    vetoed = _clearly_worse(after - loss) and _foretold(field.prepared, case, chosen, longer)
    if vetoed or not _all_needed(field, case, longer):
        return None
    return longer, after


def _exchanged(field: Field, case: Case, chosen: Chosen) -> Chosen:
    """Each of several in turn replaced by what explains more beside the others."""
    if len(chosen) == 1:
        return chosen
    for index in range(len(chosen)):
        others = (*chosen[:index], *chosen[index + 1 :])
        order, _ = ranked(field, case, others)
        if order:
            chosen = (*chosen[:index], order[0], *chosen[index + 1 :])
    return chosen


def _all_needed(field: Field, case: Case, chosen: Chosen) -> bool:
    """Whether each one explains, beside the others, more than no-effect data do."""
    if len(chosen) == 1:
        return True
    prepared, whole = field.prepared, float(drop(field.prepared, case, field.prepared.columns(chosen)))
    for index, one in enumerate(chosen):
        others = prepared.columns((*chosen[:index], *chosen[index + 1 :]))
        k = prepared.columns((one,)).size
        if surprise(whole - drop(prepared, case, others), k) < field.threshold:
            return False
    return True


def _foretold(prepared: Prepared, case: Case, shorter: Chosen, longer: Chosen) -> bool:
    """Whether of what one more explains, blocks can foretell a share of each other."""
    few, many = prepared.columns(shorter), prepared.columns(longer)
    told = foretold(prepared, case, many[None])[0] - foretold(prepared, case, few[None])[0]
    return bool(told > TOLD * (drop(prepared, case, many) - drop(prepared, case, few)))


def _clearly_worse(loss: Array) -> bool:
    """Whether a loss, by block, is more than a standard error of its sum above 0; one block tells nothing."""
    return loss.size > 1 and bool(loss.sum() > np.std(loss, ddof=1) * np.sqrt(loss.size))


def ranked(field: Field, case: Case, chosen: Chosen) -> tuple[Chosen, float]:
    """What may be added, best first, and the surprise of the most surprising among it.

    With a known floor, how unlikely an improvement is by chance tells more than a prediction of held-out
    blocks does, and counts parameters; effects that one block alone shows cannot be predicted at all.
    """
    prepared, base = field.prepared, field.prepared.columns(chosen)
    beside = float(drop(prepared, case, base)) if chosen else 0.0
    taken = np.isin(field.label, field.label[list(chosen)])
    who, surprises = [np.zeros(0, np.intp)], [np.zeros(0)]
    for k, hypotheses, columns in _sets(field, base, ~taken):
        t = sizes(prepared, case, columns)
        gains = np.sum(t * case.all[columns], axis=-1) - beside
        ok = within(prepared, t, columns) & (gains > 0.0)
        who.append(hypotheses[ok])
        surprises.append(surprise(gains[ok], k))
    index, high = np.concatenate(who), np.concatenate(surprises)
    order = np.argsort(-high, kind="stable")
    return tuple(int(h) for h in index[order]), float(high[order[0]]) if order.size else 0.0


def _sets(field: Field, base: Ints, free: Flags) -> list[tuple[int, Ints, Ints]]:
    """By number of columns k: hypotheses that may be added (n,), and their columns after the base (n, j)."""
    prepared = field.prepared
    ranks = np.bincount(prepared.owner, minlength=len(prepared.hypotheses))
    starts = np.cumsum(ranks) - ranks
    result = []
    for k in np.unique(ranks):
        hypotheses = np.flatnonzero((ranks == k) & free & field.inside)
        own = starts[hypotheses, None] + np.arange(k)
        columns = np.hstack([np.broadcast_to(base, (hypotheses.size, base.size)), own])
        result.append((int(k), hypotheses, columns))
    return result


def _loss(prepared: Prepared, case: Case, chosen: Chosen) -> Array:
    """(B,)."""
    return np.asarray(losses(prepared, case, prepared.columns(chosen)[None])[0])


def _shares(prepared: Prepared, case: Case, chosen: Chosen, dropped: float) -> tuple[float, ...]:
    """What is lost without each, as a share of what all explain."""
    without = [
        float(drop(prepared, case, prepared.columns((*chosen[:i], *chosen[i + 1 :]))))
        if len(chosen) > 1
        else 0.0
        for i in range(len(chosen))
    ]
    return tuple((dropped - one) / dropped for one in without)
