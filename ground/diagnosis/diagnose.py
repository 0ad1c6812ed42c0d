"""One case, from evidence to verdict."""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.stats import norm

from fsw.kinematics.transforms import Array
from ground.diagnosis.bootstrap import (
    Alternatives,
    bootstrap_selections,
    find_alternatives,
    replacement_deviances,
)
from ground.diagnosis.confidence import ConfidenceFeatures, compute_confidence_features
from ground.diagnosis.linear_fit import LinearFit, fit_linear, whitened_residual
from ground.diagnosis.model import DiagnosisModel
from ground.diagnosis.nonlinear_fit import (
    NonlinearFit,
    QuadraticSurrogate,
    SimulatorResponse,
    fit_nonlinear,
    linearise_at,
)
from ground.diagnosis.normal_equations import (
    NormalEquations,
    RightHandSide,
    form_normal_equations,
    reduce_features,
    reduce_residuals,
)
from ground.diagnosis.problem import INTERVAL_QUANTILES, Hypothesis, Residuals, Simulator
from ground.diagnosis.residual_analysis import (
    FeatureGroup,
    LackOfFit,
    ResidualCell,
    find_lack_of_fit,
    map_residual,
)
from ground.diagnosis.selection import CandidateSet, Selection, Subset, select_effects


@dataclass(frozen=True, slots=True, eq=False)
class ModelComparison:
    """Who won, and against whom."""

    chosen: Subset
    fit: NonlinearFit
    """What won, with the simulator, beside nuisances of its own."""
    runner_up: Subset
    deviance_margin: float
    """By how much, in deviance; parameters count. Infinite if the rival is at a bound, and no finding."""

    def replacement_for(self, one: int, chosen: Subset) -> int | None:
        """What the rival has in the place of one, if what won the duel was chosen in the end, too."""
        others = set(chosen) - {one}
        if set(chosen) != set(self.chosen) or one in self.runner_up or not others < set(self.runner_up):
            return None
        (other,) = set(self.runner_up) - others
        return other


Verdict = Literal["named", "set", "none", "unknown"]
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

    verdict: Verdict
    findings: tuple[Finding, ...]
    """If unknown: what comes nearest, not a name."""
    ranking: Subset
    """All single hypotheses that explain anything, best first, whether or not there is an effect."""
    neg_log10_p: float
    """Of the best of them, -log10 of its probability if there is no effect."""
    unexplained: tuple[LackOfFit, ...]
    """What remains after the findings, most surprising first."""
    unexplained_neg_log10_p: float
    """Of the first of them; beside findings, of the best hypothesis that might be added if that is more."""
    residual_map: tuple[ResidualCell, ...]
    """Of the residual with no effect, nuisances fitted."""
    null_fit: LinearFit
    """Nuisances alone."""
    effect_fit: LinearFit
    """Nuisances beside the findings."""
    equations: NormalEquations
    """What `best` is in terms of."""
    log_odds: float = float("nan")
    """Log-odds that the findings are the causes (ground.diagnosis.confidence); NaN without findings."""


def diagnose(
    model: DiagnosisModel,
    residuals: Residuals,
    seed: int,
    simulator: Simulator | None = None,
    comparison: ModelComparison | None = None,
) -> Diagnosis:
    """With the simulator in the loop for what is found if it is given, otherwise by its parabolas.

    What won a duel is what all others race against, and its rival may stand in its stead.
    """
    rhs, y = reduce_residuals(model.equations, residuals)
    without = fit_linear(model.equations, rhs, model.equations.columns(()))
    cells = map_residual(residuals.layout, whitened_residual(model.equations, without, y), seed)
    selection = select_effects(model.candidates, rhs)
    candidates, first = model.candidates, selection.chosen if comparison is None else comparison.chosen
    if first:
        fit = fit_subset(model, y, rhs, first, simulator) if comparison is None else comparison.fit
        candidates = _relinearise(model, candidates, rhs, y, first, selection.ranking, fit)
        selection = select_effects(candidates, reduce_features(candidates.equations, y))
    if not selection.chosen:
        return _no_effect(model, selection, without, y, cells, bool(first))
    if set(selection.chosen) == set(first):
        fit = fit.in_order([first.index(one) for one in selection.chosen])
    else:
        fit = fit_subset(model, y, rhs, selection.chosen, simulator)
        candidates = _relinearise(model, candidates, rhs, y, selection.chosen, selection.ranking, fit)
    equations, there = candidates.equations, reduce_features(candidates.equations, y)
    best = fit_linear(equations, there, equations.columns(selection.chosen))
    remaining = find_lack_of_fit(equations, _project_groups(model, equations), best, y)
    features = compute_confidence_features(
        candidates, model.cosine, there, selection.chosen, selection.shares, remaining[0].neg_log10_p
    )
    findings = _make_findings(model, candidates, there, selection, fit, seed, comparison)
    verdict, strange = _decide(model, findings, features), max(features.lack_of_fit, features.addition)
    return Diagnosis(
        verdict, findings, selection.ranking, selection.neg_log10_p, remaining, strange, cells, without, best,
        equations, model.thresholds.trust.log_odds(features),
    )  # fmt: skip


def fit_subset(
    model: DiagnosisModel, y: Array, rhs: RightHandSide, chosen: Subset, simulator: Simulator | None
) -> NonlinearFit:
    """Some hypotheses fitted together to whitened features y (m,), from where straight lines have them."""
    surrogate = QuadraticSurrogate(model.sensitivities)
    fit = fit_nonlinear(surrogate, model.equations, y, _linear_start(model, rhs, chosen))
    if simulator is None:
        return fit
    near = dict(zip(fit.hypotheses, fit.values, strict=True))
    return fit_nonlinear(SimulatorResponse(simulator, surrogate), model.equations, y, near)


def _no_effect(
    model: DiagnosisModel,
    selection: Selection,
    without: LinearFit,
    y: Array,
    cells: tuple[ResidualCell, ...],
    beyond: bool,
) -> Diagnosis:
    """No effect; unknown if there is structure all the same, or an effect `beyond` all that it may be."""
    remaining = find_lack_of_fit(model.equations, model.groups, without, y)
    strange = remaining[0].neg_log10_p
    verdict: Verdict = "unknown" if beyond or strange >= model.thresholds.structure else "none"
    return Diagnosis(
        verdict,
        (),
        selection.ranking,
        selection.neg_log10_p,
        remaining,
        strange,
        cells,
        without,
        without,
        model.equations,
    )


def _decide(model: DiagnosisModel, findings: tuple[Finding, ...], features: ConfidenceFeatures) -> Verdict:
    """No name is forced where structure remains, or where something else might as well be imitated."""
    strange = max(features.lack_of_fit, features.addition) >= model.thresholds.unexplained
    if strange or not model.thresholds.trust.accepts(features) or any(one.at_bound for one in findings):
        return "unknown"
    alone = all(finding.alternatives.hypotheses == (finding.hypothesis,) for finding in findings)
    return "named" if alone else "set"


def _make_findings(
    model: DiagnosisModel,
    candidates: CandidateSet,
    rhs: RightHandSide,
    selection: Selection,
    fit: NonlinearFit,
    seed: int,
    comparison: ModelComparison | None,
) -> tuple[Finding, ...]:
    """What was chosen, with the values of all of them fitted together."""
    drawn = find_alternatives(
        candidates, model.cosine, selection, bootstrap_selections(candidates, rhs, selection, seed)
    )
    others = [
        own.with_likelihoods(one, _replacements(candidates, rhs, selection.chosen, one, comparison))
        for one, own in zip(selection.chosen, drawn, strict=True)
    ]
    result = []
    for index, hypothesis in enumerate(selection.chosen):
        values, half = fit.values[index], norm.ppf(INTERVAL_QUANTILES[1]) * fit.sigma[index]
        ends = [(p.least, p.most) for p in model.sensitivities.hypotheses[hypothesis].parameters]
        low, high = np.clip([values - half, values + half], *np.transpose(ends))
        result.append(Finding(
            hypothesis, values, low, high, selection.shares[index], others[index],
            model.confusable(hypothesis), fit.at_bound[index],
        ))  # fmt: skip
    return tuple(result)


def _replacements(
    candidates: CandidateSet, rhs: RightHandSide, chosen: Subset, one: int, comparison: ModelComparison | None
) -> dict[int, float]:
    """What leaves how much more deviance in the place of one: by straight lines, and in a duel."""
    found = replacement_deviances(candidates, rhs, chosen, one)
    other = None if comparison is None else comparison.replacement_for(one, chosen)
    if comparison is not None and other is not None:
        found[candidates.class_representative(other)] = comparison.deviance_margin
    return found


def _relinearise(
    model: DiagnosisModel,
    candidates: CandidateSet,
    rhs: RightHandSide,
    y: Array,
    chosen: Subset,
    ranking: Subset,
    fit: NonlinearFit,
) -> CandidateSet:
    """The chosen linearised where they were found to be together, the next best where they would be alone.

    Those at a bound are out.
    """
    surrogate = QuadraticSurrogate(model.sensitivities)
    inside, changed = candidates.allowed.copy(), _joint_columns(surrogate, chosen, fit)
    inside[[one for one, at_bound in zip(chosen, fit.at_bound, strict=True) if at_bound]] = False
    for hypothesis in [one for one in ranking[:SHORTLIST] if one not in chosen]:
        alone = fit_nonlinear(surrogate, model.equations, y, _linear_start(model, rhs, (hypothesis,)))
        if alone.at_bound[0]:
            inside[hypothesis] = False
        elif np.any(alone.change):
            (values,), (slopes,) = alone.values, alone.slopes
            changed[hypothesis] = linearise_at(
                model.sensitivities.hypotheses[hypothesis], values, alone.change, slopes
            )
    return CandidateSet(
        form_normal_equations(model.sensitivities, changed), candidates.label, candidates.threshold, inside
    )


def _joint_columns(surrogate: QuadraticSurrogate, chosen: Subset, fit: NonlinearFit) -> dict[int, Array]:
    """Columns of effects where they were found to be; what only all of them change is the largest's."""
    own = [surrogate.change({h: v}) for h, v in zip(fit.hypotheses, fit.values, strict=True)]
    largest = int(np.argmax([np.linalg.norm(one / surrogate.sensitivities.layout.sigma) for one in own]))
    own[largest] = fit.change - sum(own[:largest] + own[largest + 1 :], np.zeros(fit.change.size))
    parts = zip(chosen, fit.hypotheses, fit.values, own, fit.slopes, strict=True)
    return {one: linearise_at(h, v, change, slopes) for one, h, v, change, slopes in parts if np.any(change)}


def _linear_start(model: DiagnosisModel, rhs: RightHandSide, chosen: Subset) -> dict[Hypothesis, Array]:
    """Values of some hypotheses beside each other, in straight lines."""
    columns = model.equations.columns(chosen)
    theta = fit_linear(model.equations, rhs, columns).theta[model.equations.q :]
    own = {one: theta[model.equations.owner[columns] == one] for one in chosen}
    return {model.sensitivities.hypotheses[one]: _parameter_values(model, one, t) for one, t in own.items()}


def _parameter_values(model: DiagnosisModel, hypothesis: int, t: Array) -> Array:
    """Values of all parameters of a hypothesis whose sizes are t in standard errors."""
    what = model.sensitivities.hypotheses[hypothesis]
    scale = model.equations.scale[model.equations.owner == hypothesis]
    values, at = what.absent, np.flatnonzero([parameter.is_amplitude for parameter in what.parameters])
    values[at] += np.array([what.parameters[index].typical for index in at]) * t / scale
    return values


def _project_groups(model: DiagnosisModel, equations: NormalEquations) -> tuple[FeatureGroup, ...]:
    """Groups in terms of the columns as they are."""
    return tuple(replace(group, AQ=equations.A[group.rows].T @ group.Q) for group in model.groups)
