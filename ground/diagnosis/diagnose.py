"""One case, from evidence to verdict."""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.stats import norm

from fsw.kinematics.transforms import Array
from ground.diagnosis.bootstrap import Alternatives, alternatives, instead, redrawn
from ground.diagnosis.case import Case, case_of, reduced
from ground.diagnosis.curved import Curved
from ground.diagnosis.duel import Duel
from ground.diagnosis.hypothesis import Hypothesis
from ground.diagnosis.interval import ENDS
from ground.diagnosis.layout import Evidence
from ground.diagnosis.model import Fitted, fitted, left
from ground.diagnosis.prepared import Prepared, prepare
from ground.diagnosis.race import Chosen, Field, Race, race
from ground.diagnosis.ready import Ready
from ground.diagnosis.refine import Refined, Simulated, columns_at, refine
from ground.diagnosis.simulator import Simulator
from ground.diagnosis.structure import Group, Remains, remains
from ground.diagnosis.trust import Signs, signs_of
from ground.diagnosis.where import Cell, where

Kind = Literal["named", "set", "none", "unknown"]
SHORTLIST: Final = 4
"""Hypotheses that are refined beside those chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """An effect that was chosen."""

    hypothesis: int
    values: Array
    """Of all its parameters, in their order and units."""
    least: Array
    """90 % interval of them, within their bounds; NaN of one that only shapes and that data do not tell."""
    most: Array
    share: float
    """Its own share of what all chosen explain: what is lost without it."""
    alternatives: Alternatives
    confusable: tuple[int, ...]
    """Its class, which this campaign cannot tell apart."""
    at_bound: tuple[str, ...] = ()
    """Parameters that would go beyond their bounds: then it is no cause, whatever it explains."""


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """What is said of one case."""

    verdict: Kind
    findings: tuple[Finding, ...]
    """If unknown: what comes nearest, not a name."""
    ranking: Chosen
    """All single hypotheses that explain anything, best first, whether or not there is an effect."""
    surprise: float
    """Of the best of them, -log10 of its probability if there is no effect."""
    unexplained: tuple[Remains, ...]
    """What remains after the findings, most surprising first."""
    unexplained_surprise: float
    """Of the first of them; beside findings, of the best hypothesis that might be added if that is more."""
    where: tuple[Cell, ...]
    """Of the residual with no effect, nuisances fitted."""
    without: Fitted
    """Nuisances alone."""
    best: Fitted
    """Nuisances beside the findings."""
    prepared: Prepared
    """What `best` is in terms of."""
    odds: float = float("nan")
    """Log-odds that the findings are the causes (ground.diagnosis.trust); NaN without findings."""


def diagnose(
    ready: Ready,
    evidence: Evidence,
    seed: int,
    simulator: Simulator | None = None,
    duel: Duel | None = None,
) -> Diagnosis:
    """With the simulator in the loop for what is found if it is given, otherwise by its parabolas.

    What won a duel is what all others race against, and its rival may stand in its stead.
    """
    case, y = case_of(ready.prepared, evidence)
    without = fitted(ready.prepared, case, ready.prepared.columns(()))
    cells = where(evidence.layout, left(ready.prepared, without, y), seed)
    won = race(ready.field, case)
    field, first = ready.field, won.chosen if duel is None else duel.chosen
    if first:
        final = refined(ready, y, case, first, simulator) if duel is None else duel.final
        field = _bent(ready, field, case, y, first, won.first, final)
        won = race(field, reduced(field.prepared, y))
    if not won.chosen:
        return _nothing(ready, won, without, y, cells, bool(first))
    if set(won.chosen) == set(first):
        final = final.in_order([first.index(one) for one in won.chosen])
    else:
        final = refined(ready, y, case, won.chosen, simulator)
        field = _bent(ready, field, case, y, won.chosen, won.first, final)
    prepared, there = field.prepared, reduced(field.prepared, y)
    best = fitted(prepared, there, prepared.columns(won.chosen))
    remaining = remains(prepared, _looked(ready, prepared), best, y)
    signs = signs_of(field, ready.cosine, there, won.chosen, won.shares, remaining[0].surprise)
    findings = _findings(ready, field, there, won, final, seed, duel)
    verdict, strange = _verdict(ready, findings, signs), max(signs.remains, signs.addable)
    return Diagnosis(
        verdict, findings, won.first, won.surprise, remaining, strange, cells, without, best,
        prepared, ready.thresholds.trust.odds(signs),
    )  # fmt: skip


def refined(ready: Ready, y: Array, case: Case, chosen: Chosen, simulator: Simulator | None) -> Refined:
    """Some hypotheses fitted together to whitened features y (m,), from where straight lines have them."""
    curved = Curved(ready.found)
    final = refine(curved, ready.prepared, y, _start(ready, case, chosen))
    if simulator is None:
        return final
    near = dict(zip(final.hypotheses, final.values, strict=True))
    return refine(Simulated(simulator, curved), ready.prepared, y, near)


def _nothing(
    ready: Ready, won: Race, without: Fitted, y: Array, cells: tuple[Cell, ...], beyond: bool
) -> Diagnosis:
    """No effect; unknown if there is structure all the same, or an effect `beyond` all that it may be."""
    remaining = remains(ready.prepared, ready.looked, without, y)
    strange = remaining[0].surprise
    verdict: Kind = "unknown" if beyond or strange >= ready.thresholds.structure else "none"
    return Diagnosis(
        verdict, (), won.first, won.surprise, remaining, strange, cells, without, without, ready.prepared
    )


def _verdict(ready: Ready, findings: tuple[Finding, ...], signs: Signs) -> Kind:
    """No name is forced where structure remains, or where something else might as well be imitated."""
    strange = max(signs.remains, signs.addable) >= ready.thresholds.unexplained
    if strange or not ready.thresholds.trust.allows(signs) or any(one.at_bound for one in findings):
        return "unknown"
    alone = all(finding.alternatives.hypotheses == (finding.hypothesis,) for finding in findings)
    return "named" if alone else "set"


def _findings(
    ready: Ready, field: Field, case: Case, won: Race, final: Refined, seed: int, duel: Duel | None
) -> tuple[Finding, ...]:
    """What was chosen, with the values of all of them fitted together."""
    drawn = alternatives(field, ready.cosine, won, redrawn(field, case, won, seed))
    others = [
        own.beside(one, _instead(field, case, won.chosen, one, duel))
        for one, own in zip(won.chosen, drawn, strict=True)
    ]
    result = []
    for index, hypothesis in enumerate(won.chosen):
        values, half = final.values[index], norm.ppf(ENDS[1]) * final.sigma[index]
        ends = [(p.least, p.most) for p in ready.found.hypotheses[hypothesis].parameters]
        low, high = np.clip([values - half, values + half], *np.transpose(ends))
        result.append(Finding(
            hypothesis, values, low, high, won.shares[index], others[index],
            ready.confusable(hypothesis), final.at_bound[index],
        ))  # fmt: skip
    return tuple(result)


def _instead(field: Field, case: Case, chosen: Chosen, one: int, duel: Duel | None) -> dict[int, float]:
    """What leaves how much more deviance in the place of one: by straight lines, and in a duel."""
    found = instead(field, case, chosen, one)
    other = None if duel is None else duel.instead_of(one, chosen)
    if duel is not None and other is not None:
        found[field.standing_for(other)] = duel.worse
    return found


def _bent(
    ready: Ready, field: Field, case: Case, y: Array, chosen: Chosen, ranking: Chosen, final: Refined
) -> Field:
    """The chosen linearised where they were found to be together, the next best where they would be alone.

    Those at a bound are out.
    """
    curved = Curved(ready.found)
    inside, changed = field.inside.copy(), _together(curved, chosen, final)
    inside[[one for one, at_bound in zip(chosen, final.at_bound, strict=True) if at_bound]] = False
    for hypothesis in [one for one in ranking[:SHORTLIST] if one not in chosen]:
        alone = refine(curved, ready.prepared, y, _start(ready, case, (hypothesis,)))
        if alone.at_bound[0]:
            inside[hypothesis] = False
        elif np.any(alone.change):
            (values,), (slopes,) = alone.values, alone.slopes
            changed[hypothesis] = columns_at(ready.found.hypotheses[hypothesis], values, alone.change, slopes)
    return Field(prepare(ready.found, changed), field.label, field.threshold, inside)


def _together(curved: Curved, chosen: Chosen, final: Refined) -> dict[int, Array]:
    """Columns of effects where they were found to be; what only all of them change is the largest's."""
    own = [curved.change({h: v}) for h, v in zip(final.hypotheses, final.values, strict=True)]
    largest = int(np.argmax([np.linalg.norm(one / curved.found.layout.sigma) for one in own]))
    own[largest] = final.change - sum(own[:largest] + own[largest + 1 :], np.zeros(final.change.size))
    parts = zip(chosen, final.hypotheses, final.values, own, final.slopes, strict=True)
    return {one: columns_at(h, v, change, slopes) for one, h, v, change, slopes in parts if np.any(change)}


def _start(ready: Ready, case: Case, chosen: Chosen) -> dict[Hypothesis, Array]:
    """Values of some hypotheses beside each other, in straight lines."""
    columns = ready.prepared.columns(chosen)
    theta = fitted(ready.prepared, case, columns).theta[ready.prepared.q :]
    own = {one: theta[ready.prepared.owner[columns] == one] for one in chosen}
    return {ready.found.hypotheses[one]: _values(ready, one, t) for one, t in own.items()}


def _values(ready: Ready, hypothesis: int, t: Array) -> Array:
    """Values of all parameters of a hypothesis whose sizes are t in standard errors."""
    what = ready.found.hypotheses[hypothesis]
    scale = ready.prepared.scale[ready.prepared.owner == hypothesis]
    values, at = what.absent, np.flatnonzero([parameter.sizes for parameter in what.parameters])
    values[at] += np.array([what.parameters[index].typical for index in at]) * t / scale
    return values


def _looked(ready: Ready, prepared: Prepared) -> tuple[Group, ...]:
    """Groups in terms of the columns as they are."""
    return tuple(replace(group, AQ=prepared.A[group.rows].T @ group.Q) for group in ready.looked)
