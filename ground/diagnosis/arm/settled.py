"""Where a case's nuisances are: the simulator asked about them until they stay.

They may be large, and are no straight lines: what they bend looks like effects. Where they are depends on
what they are fitted beside, so that what wins may have to fight for it once more.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from fsw.kinematics.transforms import Array
from ground.diagnosis.arm.bound import Bound, asked_again
from ground.diagnosis.arm.simulator import Touched
from ground.diagnosis.case import Case, case_of
from ground.diagnosis.diagnose import refined
from ground.diagnosis.duel import Duel
from ground.diagnosis.fits import deviance_of, surprise
from ground.diagnosis.layout import Evidence
from ground.diagnosis.model import fitted
from ground.diagnosis.prepared import left_over
from ground.diagnosis.race import Chosen, Race, race, ranked, surprise_of
from ground.diagnosis.ready import Ready
from ground.diagnosis.refine import Refined
from sim.effects.effect import Effect
from sim.plant import PlantDiverged

MOVED: Final = 0.25
"""Sigmas by which a nuisance must have moved for the simulator to be asked again."""
FARTHEST: Final = 10.0
"""Sigmas up to which it is asked: what an effect makes of a nuisance that is like it may be no arm at all."""
PASSES: Final = 3
NEARLY: Final = 0.2
"""Of the surprise, the share by which a rival may fall short before it has nuisances of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """The simulator asked about some nuisances, and what explains the case in straight lines from there."""

    case: Bound
    nuisance: Array
    """(q,)."""
    gap: Array
    """Measured less simulated with nuisances at 0, in straight lines from where they are, (m,)."""
    told: Case
    won: Race
    nothing: float
    """Deviance that nuisances alone leave."""
    cost: float
    """Deviance that is left beside what won, and what as many effects without a cause would explain."""
    duel: Duel | None = None
    """Between what won and what explains it nearly as well."""


def settled(known: Ready, first: Bound, patch: tuple[Effect, ...]) -> Settled:
    """The nuisances settled alone, and if there is an effect all the same, beside it.

    Alone they would take the place of an effect that they are like. That they bend may still be the simpler
    explanation.
    """
    first_look = _asked(known, first, np.zeros(len(first.nuisances)))
    alone = _settled(known, first_look, patch, lambda _: ())
    if not alone.won.chosen:
        return alone
    beside = _settled(known, alone, patch, lambda here: here.won.chosen)
    if not beside.won.chosen:
        return beside
    # what wins from `alone` has nuisances elsewhere, so only what is left there without it can be believed
    return _duel(known, alone, beside, patch) if beside.cost < alone.nothing else alone


def _duel(known: Ready, alone: Settled, beside: Settled, patch: tuple[Effect, ...]) -> Settled:
    """What won or what comes nearest to it, each beside nuisances of its own: the more surprising one."""
    rival = _near(known, alone, beside.won.chosen)
    if not rival:
        return beside
    try:
        return _fought(known, alone, beside, rival, patch)
    except PlantDiverged:  # there is no such arm, so it explains nothing
        return beside


def _fought(
    known: Ready, alone: Settled, beside: Settled, rival: Chosen, patch: tuple[Effect, ...]
) -> Settled:
    there = _settled(known, alone, patch, lambda _: rival)
    if not there.won.chosen:  # where the rival would be, nothing may be the simpler explanation
        return there if there.nothing < beside.cost else beside
    chosen = beside.won.chosen
    here = _settled(known, beside, patch, lambda _: chosen)
    ours, mine = _fitted(known, here, chosen, alone.nothing)
    theirs, other = _fitted(known, there, rival, alone.nothing)
    if other > mine:
        return replace(there, duel=Duel(rival, theirs, chosen, deviance_of(other - mine)))
    if not np.isfinite(mine):
        return beside
    return replace(here, duel=Duel(chosen, ours, rival, deviance_of(mine - other)))


def _fitted(known: Ready, here: Settled, chosen: Chosen, before: float) -> tuple[Refined, float]:
    """Some effects with the simulator, where nuisances are, and the surprise of what they explain.

    Of a deviance `before`. What is at a bound is no finding, and surprises nobody: -inf.
    """
    final = refined(known, known.prepared.whiten(here.gap), here.told, chosen, here.case)
    if any(final.at_bound):
        return final, -np.inf
    k = known.prepared.columns(chosen).size
    return final, float(surprise(np.array(max(before - final.cost, 0.0)), k))


def _near(known: Ready, alone: Settled, chosen: Chosen) -> Chosen:
    """The best with another class in place of one of them, where nuisances favour neither; or nothing."""
    field, found = known.field, dict[Chosen, float]()
    for index, one in enumerate(chosen):
        others = (*chosen[:index], *chosen[index + 1 :])
        order, _ = ranked(field, alone.told, others)
        rival = next((h for h in order if field.label[h] != field.label[one]), None)
        if rival is not None:
            instead = (*chosen[:index], rival, *chosen[index + 1 :])
            found[instead] = surprise_of(field, alone.told, instead)
    best = max(found, key=found.__getitem__, default=())
    return best if best and found[best] > (1.0 - NEARLY) * surprise_of(field, alone.told, chosen) else ()


def _settled(
    known: Ready, begun: Settled, patch: tuple[Effect, ...], beside: Callable[[Settled], Chosen]
) -> Settled:
    """Until nuisances stay where they are beside some effects, or leave no effect to be found."""
    here = begun
    least = MOVED * np.array([nuisance.sigma for nuisance in known.found.nuisances])
    for asked_before in range(PASSES):
        if asked_before and not here.won.chosen:
            break
        arm, there = here.case.arm, _nuisances(known, here, beside(here))
        by = there - here.nuisance
        moved = arm.effects({}, np.where(np.abs(by) > least, by, 0.0))
        if not moved:
            break
        near, otherwise = (*patch, *arm.effects({}, there)), known.found.nuisance @ by
        here = _asked(known, asked_again(here.case, near, Touched(tuple(moved)), otherwise), there)
    return here


def _asked(known: Ready, case: Bound, nuisance: Array) -> Settled:
    gap = case.gap() + known.found.nuisance @ nuisance
    told, y = case_of(known.prepared, Evidence(known.found.layout, gap))
    won = race(known.field, told)
    k = known.prepared.columns(won.chosen).size
    needed = float(chi2.isf(10.0**-known.thresholds.effect, k)) if k else 0.0
    nothing = left_over(known.prepared, y)
    return Settled(case, nuisance, gap, told, won, nothing, nothing - won.dropped + needed)


def _nuisances(known: Ready, here: Settled, beside: Chosen) -> Array:
    """As they are beside some effects, (q,), within what can be asked.

    Those that are drawn in every block, and those that cannot be had in parts, stay 0.
    """
    prepared = known.prepared
    model = fitted(prepared, here.told, prepared.columns(beside))
    found = np.zeros(len(known.found.nuisances))
    found[known.found.lasting] = model.theta[: prepared.q] * prepared.nuisance_unit
    far = FARTHEST * np.array([nuisance.sigma for nuisance in known.found.nuisances])
    return np.where([one.one_sided for one in here.case.arm.uncertain], 0.0, np.clip(found, -far, far))
