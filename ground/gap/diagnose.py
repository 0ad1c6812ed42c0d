"""One case, from evidence to verdict."""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.stats import norm

from fsw.kinematics.transforms import Array
from ground.gap.bootstrap import Alternatives, alternatives, redrawn
from ground.gap.case import Case, case_of, reduced
from ground.gap.hypothesis import Hypothesis
from ground.gap.layout import Evidence
from ground.gap.model import Fitted, fitted, left
from ground.gap.prepared import Prepared, prepare
from ground.gap.race import Chosen, Field, Race, best_left, race
from ground.gap.ready import Ready
from ground.gap.refine import Refined, columns_at, refine
from ground.gap.simulator import Simulator
from ground.gap.structure import Group, Remains, remains
from ground.gap.where import Cell, where

Kind = Literal["named", "set", "none", "unknown"]
LEVEL: Final = 0.9
SHORTLIST: Final = 4
"""Hypotheses that are refined beside those chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """An effect that was chosen."""

    hypothesis: int
    values: Array
    """Of all its parameters, in their order and units."""
    least: Array
    """90 % interval of them; NaN of one that was not fitted."""
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
    where: tuple[Cell, ...]
    """Of the residual with no effect, nuisances fitted."""
    without: Fitted
    """Nuisances alone."""
    best: Fitted
    """Nuisances beside the findings."""
    prepared: Prepared
    """What `best` is in terms of."""


def diagnose(ready: Ready, evidence: Evidence, seed: int, simulator: Simulator | None = None) -> Diagnosis:
    """With the simulator in the loop if it is given, otherwise in straight lines."""
    case, y = case_of(ready.prepared, evidence)
    field = ready.field
    without = fitted(ready.prepared, case, ready.prepared.columns(()))
    cells = where(evidence.layout, left(ready.prepared, without, y), seed)
    won = race(field, case)
    if simulator is not None and won.chosen:
        field = _refined(ready, field, evidence, won, simulator)
        case = reduced(field.prepared, y)
        won = race(field, case)
    prepared = field.prepared
    best = fitted(prepared, case, prepared.columns(won.chosen))
    remaining = remains(prepared, _looked(ready, prepared), best, y)
    strange = max(remaining[0].surprise, best_left(field, case, won.chosen) if won.chosen else 0.0)
    findings = _findings(ready, field, case, won, seed)
    if simulator is not None and won.chosen:
        findings = _exact(ready, evidence, findings, simulator)
    verdict = _verdict(ready, findings, strange)
    return Diagnosis(
        verdict, findings, won.first, won.surprise, remaining, strange, cells, without, best, prepared,
    )  # fmt: skip


def _verdict(ready: Ready, findings: tuple[Finding, ...], strange: float) -> Kind:
    """No name is forced where structure remains."""
    if not findings:
        return "unknown" if strange >= ready.thresholds.structure else "none"
    if strange >= ready.thresholds.unexplained or any(finding.at_bound for finding in findings):
        return "unknown"
    alone = all(len(finding.alternatives.hypotheses) == 1 for finding in findings)
    return "named" if alone else "set"


def _findings(ready: Ready, field: Field, case: Case, won: Race, seed: int) -> tuple[Finding, ...]:
    """What was chosen, in straight lines."""
    if not won.chosen:
        return ()
    prepared = field.prepared
    columns = prepared.columns(won.chosen)
    sigma = np.sqrt(np.diag(np.linalg.pinv(prepared.R[-1][np.ix_(columns, columns)], hermitian=True)))
    others = alternatives(field, ready.cosine, won, redrawn(field, case, won, seed))
    result = []
    for index, hypothesis in enumerate(won.chosen):
        at = prepared.owner[columns] == hypothesis
        t = won.t[at] / prepared.scale[columns[at]]
        values, spread = _in_units(
            ready.found.hypotheses[hypothesis], t, sigma[at] / prepared.scale[columns[at]]
        )
        result.append(Finding(
            hypothesis, values, values - spread, values + spread, won.shares[index], others[index],
            ready.confusable(hypothesis),
        ))  # fmt: skip
    return tuple(result)


def _in_units(hypothesis: Hypothesis, t: Array, sigma: Array) -> tuple[Array, Array]:
    """Values of all parameters, and half of their 90 % intervals, NaN where not fitted."""
    values = np.array([parameter.absent for parameter in hypothesis.parameters])
    spread = np.full(values.size, np.nan)
    at = np.flatnonzero([parameter.sizes for parameter in hypothesis.parameters])
    if at.size == t.size:
        typical = np.array([hypothesis.parameters[index].typical for index in at])
        values[at] += typical * t
        spread[at] = norm.ppf((1.0 + LEVEL) / 2.0) * np.abs(typical) * sigma
    return values, spread


def _refined(ready: Ready, field: Field, evidence: Evidence, won: Race, simulator: Simulator) -> Field:
    """The chosen and the next best linearised at what they would be alone; those at a bound are out."""
    shortlist = dict.fromkeys((*won.chosen, *won.first[:SHORTLIST]))
    inside, changed = field.inside.copy(), {}
    case, _ = case_of(ready.prepared, evidence)
    for hypothesis in shortlist:
        with_it = fitted(ready.prepared, case, ready.prepared.columns((hypothesis,)))
        start = _start(ready, hypothesis, with_it.theta[ready.prepared.q :])
        alone = refine(simulator, ready.prepared, evidence, ready.found.nominal, start)
        if alone.at_bound[0]:
            inside[hypothesis] = False
        elif np.any(alone.change):
            changed[hypothesis] = columns_at(alone)
    return Field(prepare(ready.found, changed), field.label, field.threshold, inside)


def _start(ready: Ready, hypothesis: int, t: Array) -> dict[Hypothesis, Array]:
    """Values of a hypothesis of sizes t in standard errors."""
    what = ready.found.hypotheses[hypothesis]
    scale = ready.prepared.scale[ready.prepared.owner == hypothesis]
    return {what: _in_units(what, t / scale, scale)[0]}


def _exact(
    ready: Ready, evidence: Evidence, findings: tuple[Finding, ...], simulator: Simulator
) -> tuple[Finding, ...]:
    """The same with the values of all of them fitted together with the simulator in the loop."""
    start: dict[Hypothesis, Array] = {}
    case, _ = case_of(ready.prepared, evidence)
    columns = ready.prepared.columns(tuple(finding.hypothesis for finding in findings))
    theta = fitted(ready.prepared, case, columns).theta[ready.prepared.q :]
    for finding in findings:
        start |= _start(ready, finding.hypothesis, theta[ready.prepared.owner[columns] == finding.hypothesis])
    together: Refined = refine(simulator, ready.prepared, evidence, ready.found.nominal, start)
    spread = [norm.ppf((1.0 + LEVEL) / 2.0) * sigma for sigma in together.sigma]
    return tuple(
        replace(finding, values=values, least=values - half, most=values + half, at_bound=at_bound)
        for finding, values, half, at_bound in zip(
            findings, together.values, spread, together.at_bound, strict=True
        )
    )


def _looked(ready: Ready, prepared: Prepared) -> tuple[Group, ...]:
    """Groups in terms of the columns as they are."""
    if prepared is ready.prepared:
        return ready.looked
    return tuple(replace(group, AQ=prepared.A[group.rows].T @ group.Q) for group in ready.looked)
