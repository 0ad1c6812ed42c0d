"""Diagnosis of one case, from residuals to verdict.

`diagnose` runs these steps. It selects effects with the linear model (`selection`), and fits them with the
simulator (`nonlinear_fit`). It linearises the equations at that fit, and selects once more. It tests what
remains (`residual_analysis`), estimates how sure the choice is (`bootstrap`, `confidence`), and decides.
"""

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

SHORTLIST: Final = 4
"""Number of single hypotheses that are linearised again beside those chosen."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelComparison:
    """Two sets of effects compared by simulation, each with its own nuisances."""

    chosen: Subset
    """Baseline: the set of effects that explains the case better."""
    fit: NonlinearFit
    """Nonlinear fit of the baseline, with its own nuisances."""
    runner_up: Subset
    deviance_margin: float
    """Advantage of the baseline in deviance, parameters counted; infinite if the runner-up is at a bound."""

    def replacement_for(self, one: int, chosen: Subset) -> int | None:
        """Return the runner-up's hypothesis in place of `one`; None if the baseline is not the choice."""
        others = set(chosen) - {one}
        if set(chosen) != set(self.chosen) or one in self.runner_up or not others < set(self.runner_up):
            return None
        (other,) = set(self.runner_up) - others
        return other


Verdict = Literal["named", "set", "none", "unknown"]


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """Selected effect, with fitted values and alternatives."""

    hypothesis: int
    values: Array
    """Fitted values of all parameters, in their order and units, shape (p,)."""
    least: Array
    """Lower end of the 90 % intervals within the bounds, shape (p,);
    NaN for a shape parameter that the data do not determine."""
    most: Array
    """Upper end, shape (p,)."""
    share: float
    """Share of the explained deviance that is lost without this effect."""
    alternatives: Alternatives
    equivalence_class: tuple[int, ...]
    """Equivalence class: hypotheses that this campaign cannot distinguish."""
    at_bound: tuple[str, ...] = ()
    """Names of the parameters that are at a bound; such an effect is not accepted as a cause."""


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Result of one diagnosis."""

    verdict: Verdict
    findings: tuple[Finding, ...]
    """Selected effects; with verdict "unknown" the nearest ones, which are not accepted."""
    ranking: Subset
    """Single hypotheses that explain anything, best first, whether or not there is an effect."""
    neg_log10_p: float
    """-log10 p of the best single hypothesis, without effect."""
    unexplained: tuple[LackOfFit, ...]
    """Lack-of-fit tests after the findings, most significant first."""
    unexplained_neg_log10_p: float
    """Greatest -log10 p of those tests and, if there are findings, of one more hypothesis."""
    residual_map: tuple[ResidualCell, ...]
    """Map of the residual without effects, nuisances fitted."""
    null_fit: LinearFit
    """Linear fit of the nuisances alone."""
    effect_fit: LinearFit
    """Linear fit of nuisances and findings."""
    equations: NormalEquations
    """Normal equations that `effect_fit` refers to."""
    log_odds: float = float("nan")
    """Log-odds that the findings are the causes (see `confidence`); NaN without findings."""


def diagnose(
    model: DiagnosisModel,
    residuals: Residuals,
    seed: int,
    simulator: Simulator | None = None,
    comparison: ModelComparison | None = None,
) -> Diagnosis:
    """Diagnose one case.

    If two models were compared by simulation, the winner is the baseline, and the loser can be reported as an
    alternative.

    Args:
        model: Diagnosis model of the campaign.
        residuals: Residuals of the case.
        seed: Seed of the bootstrap.
        simulator: Simulator for the fit of the selected effects; None for the quadratic surrogate.
        comparison: Two sets of effects that were compared by simulation already, if any.

    Returns:
        Verdict, findings, and what remains unexplained.
    """
    rhs, y = reduce_residuals(model.equations, residuals)
    null_fit = fit_linear(model.equations, rhs, model.equations.columns(()))
    cells = map_residual(residuals.layout, whitened_residual(model.equations, null_fit, y), seed)
    selection = select_effects(model.candidates, rhs)
    candidates, first = model.candidates, selection.chosen if comparison is None else comparison.chosen
    if first:
        fit = fit_subset(model, y, rhs, first, simulator) if comparison is None else comparison.fit
        candidates = _relinearise(model, candidates, rhs, y, first, selection.ranking, fit)
        selection = select_effects(candidates, reduce_features(candidates.equations, y))
    if not selection.chosen:
        return _no_effect(model, selection, null_fit, y, cells, bool(first))
    if set(selection.chosen) == set(first):
        fit = fit.in_order([first.index(one) for one in selection.chosen])
    else:
        fit = fit_subset(model, y, rhs, selection.chosen, simulator)
        candidates = _relinearise(model, candidates, rhs, y, selection.chosen, selection.ranking, fit)
    equations, refitted_rhs = candidates.equations, reduce_features(candidates.equations, y)
    effect_fit = fit_linear(equations, refitted_rhs, equations.columns(selection.chosen))
    remaining = find_lack_of_fit(equations, _project_groups(model, equations), effect_fit, y)
    features = compute_confidence_features(
        candidates, model.cosine, refitted_rhs, selection.chosen, selection.shares, remaining[0].neg_log10_p
    )
    findings = _make_findings(model, candidates, refitted_rhs, selection, fit, seed, comparison)
    verdict, structure = _decide(model, findings, features), max(features.lack_of_fit, features.addition)
    return Diagnosis(
        verdict, findings, selection.ranking, selection.neg_log10_p, remaining, structure, cells, null_fit,
        effect_fit, equations, model.thresholds.confidence.log_odds(features),
    )  # fmt: skip


def fit_subset(
    model: DiagnosisModel, y: Array, rhs: RightHandSide, chosen: Subset, simulator: Simulator | None
) -> NonlinearFit:
    """Fit some hypotheses together, starting from their linear estimate.

    Args:
        model: Diagnosis model of the campaign.
        y: Whitened features, shape (m,).
        rhs: Right-hand side of the same case.
        chosen: Hypotheses to fit.
        simulator: Simulator for the final fit; None to stop at the quadratic surrogate.

    Returns:
        Nonlinear fit, effects in the order of `chosen`.
    """
    surrogate = QuadraticSurrogate(model.sensitivities)
    fit = fit_nonlinear(surrogate, model.equations, y, _linear_start(model, rhs, chosen))
    if simulator is None:
        return fit
    near = dict(zip(fit.hypotheses, fit.values, strict=True))
    return fit_nonlinear(SimulatorResponse(simulator, surrogate), model.equations, y, near)


def _no_effect(
    model: DiagnosisModel,
    selection: Selection,
    null_fit: LinearFit,
    y: Array,
    cells: tuple[ResidualCell, ...],
    rejected: bool,
) -> Diagnosis:
    """Report no effect; "unknown" if structure remains or if selected effects were rejected."""
    remaining = find_lack_of_fit(model.equations, model.groups, null_fit, y)
    structure = remaining[0].neg_log10_p
    verdict: Verdict = "unknown" if rejected or structure >= model.thresholds.structure else "none"
    return Diagnosis(
        verdict,
        (),
        selection.ranking,
        selection.neg_log10_p,
        remaining,
        structure,
        cells,
        null_fit,
        null_fit,
        model.equations,
    )


def _decide(model: DiagnosisModel, findings: tuple[Finding, ...], features: ConfidenceFeatures) -> Verdict:
    """Withhold the name if structure remains, a bound is reached, or the confidence is too low."""
    has_structure = max(features.lack_of_fit, features.addition) >= model.thresholds.unexplained
    if (
        has_structure
        or not model.thresholds.confidence.accepts(features)
        or any(one.at_bound for one in findings)
    ):
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
    """Return the chosen effects with values, intervals and alternatives."""
    bootstrapped = find_alternatives(
        candidates, model.cosine, selection, bootstrap_selections(candidates, rhs, selection, seed)
    )
    others = [
        own.with_likelihoods(one, _replacements(candidates, rhs, selection.chosen, one, comparison))
        for one, own in zip(selection.chosen, bootstrapped, strict=True)
    ]
    result = []
    for index, hypothesis in enumerate(selection.chosen):
        values, half = fit.values[index], norm.ppf(INTERVAL_QUANTILES[1]) * fit.sigma[index]
        ends = [(p.least, p.most) for p in model.sensitivities.hypotheses[hypothesis].parameters]
        low, high = np.clip([values - half, values + half], *np.transpose(ends))
        result.append(Finding(
            hypothesis, values, low, high, selection.shares[index], others[index],
            model.equivalence_class(hypothesis), fit.at_bound[index],
        ))  # fmt: skip
    return tuple(result)


def _replacements(
    candidates: CandidateSet, rhs: RightHandSide, chosen: Subset, one: int, comparison: ModelComparison | None
) -> dict[int, float]:
    """Return the extra deviance of each hypothesis in place of `one`: linear, or by model comparison."""
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
    """Linearise the chosen at their joint estimate, and the next best single hypotheses at their own.

    Hypotheses at a bound are excluded.
    """
    surrogate = QuadraticSurrogate(model.sensitivities)
    allowed, changed = candidates.allowed.copy(), _joint_columns(surrogate, chosen, fit)
    allowed[[one for one, at_bound in zip(chosen, fit.at_bound, strict=True) if at_bound]] = False
    for hypothesis in [one for one in ranking[:SHORTLIST] if one not in chosen]:
        alone = fit_nonlinear(surrogate, model.equations, y, _linear_start(model, rhs, (hypothesis,)))
        if alone.at_bound[0]:
            allowed[hypothesis] = False
        elif np.any(alone.change):
            (values,), (slopes,) = alone.values, alone.slopes
            changed[hypothesis] = linearise_at(
                model.sensitivities.hypotheses[hypothesis], values, alone.change, slopes
            )
    return CandidateSet(
        form_normal_equations(model.sensitivities, changed), candidates.label, candidates.threshold, allowed
    )


def _joint_columns(surrogate: QuadraticSurrogate, chosen: Subset, fit: NonlinearFit) -> dict[int, Array]:
    """Return the columns of jointly fitted effects; their interaction is assigned to the largest effect."""
    own = [surrogate.change({h: v}) for h, v in zip(fit.hypotheses, fit.values, strict=True)]
    largest = int(np.argmax([np.linalg.norm(one / surrogate.sensitivities.layout.sigma) for one in own]))
    own[largest] = fit.change - sum(own[:largest] + own[largest + 1 :], np.zeros(fit.change.size))
    parts = zip(chosen, fit.hypotheses, fit.values, own, fit.slopes, strict=True)
    return {one: linearise_at(h, v, change, slopes) for one, h, v, change, slopes in parts if np.any(change)}


def _linear_start(model: DiagnosisModel, rhs: RightHandSide, chosen: Subset) -> dict[Hypothesis, Array]:
    """Return the linear estimate of some hypotheses, fitted together."""
    columns = model.equations.columns(chosen)
    theta = fit_linear(model.equations, rhs, columns).theta[model.equations.q :]
    own = {one: theta[model.equations.owner[columns] == one] for one in chosen}
    return {model.sensitivities.hypotheses[one]: _parameter_values(model, one, a) for one, a in own.items()}


def _parameter_values(model: DiagnosisModel, hypothesis: int, a: Array) -> Array:
    """Return all parameter values of a hypothesis with amplitudes a in standard errors."""
    effect = model.sensitivities.hypotheses[hypothesis]
    scale = model.equations.scale[model.equations.owner == hypothesis]
    values, at = effect.absent, np.flatnonzero([parameter.is_amplitude for parameter in effect.parameters])
    values[at] += np.array([effect.parameters[index].typical for index in at]) * a / scale
    return values


def _project_groups(model: DiagnosisModel, equations: NormalEquations) -> tuple[FeatureGroup, ...]:
    """Return the feature groups, projected to the present columns."""
    return tuple(replace(group, AQ=equations.A[group.rows].T @ group.Q) for group in model.groups)
