"""Nuisance fit of a case: resimulation at the estimated nuisances until they converge.

Nuisance parameters can be large and act nonlinearly, so linearisation error can look like an effect. Their
estimate depends on the effects that are fitted beside them. So the best model and its runner-up each get
their own nuisances, and both are compared by simulation.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from fsw.kinematics.transforms import Array
from ground.diagnosis.arm.case_simulator import CaseSimulator, resimulate
from ground.diagnosis.arm.simulator import AffectedMotions
from ground.diagnosis.diagnose import ModelComparison, fit_subset
from ground.diagnosis.linear_fit import deviance_difference, fit_linear, neg_log10_p
from ground.diagnosis.model import DiagnosisModel
from ground.diagnosis.nonlinear_fit import NonlinearFit
from ground.diagnosis.normal_equations import RightHandSide, reduce_residuals, residual_deviance
from ground.diagnosis.problem import Residuals
from ground.diagnosis.selection import Selection, Subset, rank_additions, select_effects, subset_neg_log10_p
from sim.effects.effect import Effect
from sim.plant import PlantDiverged

MIN_CHANGE_SIGMAS: Final = 0.25
"""Sigmas by which a nuisance must change for a resimulation."""
MAX_SIGMAS: Final = 10.0
"""Greatest simulated departure: an effect can push a similar nuisance beyond any real arm."""
MAX_UPDATES: Final = 3
"""Greatest number of resimulations."""
RUNNER_UP_SHARE: Final = 0.2
"""A runner-up is simulated if its -log10 p falls short by at most this share."""


@dataclass(frozen=True, slots=True, eq=False)
class NuisanceFit:
    """Case simulated at estimated nuisances, and the effects selected there."""

    simulator: CaseSimulator
    nuisance: Array
    """Nuisances of the simulation in their units, shape (q,)."""
    residual: Array
    """Measured minus simulated, extrapolated linearly to nuisances at 0, shape (m,)."""
    rhs: RightHandSide
    selection: Selection
    null_deviance: float
    """Deviance with nuisances alone."""
    cost: float
    """Deviance beside the selected effects, plus the threshold for as many parameters."""
    comparison: ModelComparison | None = None
    """Comparison of the selected effects and the runner-up, if it was simulated."""


def fit_nuisances(model: DiagnosisModel, first: CaseSimulator, patch: tuple[Effect, ...]) -> NuisanceFit:
    """Fit the nuisances alone, and if an effect remains, beside the effect.

    Fitted beside an effect, nuisances give way to it; fitted alone, they can imitate it. The nonlinear
    response of nuisances alone can still be the simpler explanation, so the lower cost wins.

    Args:
        model: Diagnosis model of the campaign.
        first: Simulator at nominal nuisances.
        patch: Effects that are switched on in the simulator.

    Returns:
        Best fit, with the comparison to its runner-up.
    """
    first_look = _select_from(model, first, np.zeros(len(first.nuisances)))
    alone = _iterate(model, first_look, patch, lambda _: ())
    if not alone.selection.chosen:
        return alone
    beside = _iterate(model, alone, patch, lambda current: current.selection.chosen)
    if not beside.selection.chosen:
        return beside
    # nuisances differ between both fits, so the null deviance of `alone` is the fair reference
    return _compare_runner_up(model, alone, beside, patch) if beside.cost < alone.null_deviance else alone


def _compare_runner_up(
    model: DiagnosisModel, alone: NuisanceFit, beside: NuisanceFit, patch: tuple[Effect, ...]
) -> NuisanceFit:
    """Compare the selected effects with the runner-up, each with its own nuisances; return the better fit."""
    runner_up = _find_runner_up(model, alone, beside.selection.chosen)
    if not runner_up:
        return beside
    try:
        return _compare_by_simulation(model, alone, beside, runner_up, patch)
    except PlantDiverged:  # no such arm exists, so the runner-up explains nothing
        return beside


def _compare_by_simulation(
    model: DiagnosisModel,
    alone: NuisanceFit,
    beside: NuisanceFit,
    runner_up: Subset,
    patch: tuple[Effect, ...],
) -> NuisanceFit:
    runner_up_fit = _iterate(model, alone, patch, lambda _: runner_up)
    if not runner_up_fit.selection.chosen:  # nuisances alone may be simpler
        return runner_up_fit if runner_up_fit.null_deviance < beside.cost else beside
    chosen = beside.selection.chosen
    current = _iterate(model, beside, patch, lambda _: chosen)
    simulated, significance = _fit_simulated(model, current, chosen, alone.null_deviance)
    runner_up_simulated, runner_up_significance = _fit_simulated(
        model, runner_up_fit, runner_up, alone.null_deviance
    )
    if runner_up_significance > significance:
        return replace(
            runner_up_fit,
            comparison=ModelComparison(
                runner_up,
                runner_up_simulated,
                chosen,
                deviance_difference(runner_up_significance - significance),
            ),
        )
    if not np.isfinite(significance):
        return beside
    return replace(
        current,
        comparison=ModelComparison(
            chosen, simulated, runner_up, deviance_difference(significance - runner_up_significance)
        ),
    )


def _fit_simulated(
    model: DiagnosisModel, current: NuisanceFit, chosen: Subset, before: float
) -> tuple[NonlinearFit, float]:
    """Fit some effects with the simulator; return the fit, and -log10 p of what it explains of `before`.

    Returns -inf for an effect at a bound, which is not accepted.
    """
    fit = fit_subset(model, model.equations.whiten(current.residual), current.rhs, chosen, current.simulator)
    if any(fit.at_bound):
        return fit, -np.inf
    k = model.equations.columns(chosen).size
    return fit, float(neg_log10_p(np.array(max(before - fit.cost, 0.0)), k))


def _find_runner_up(model: DiagnosisModel, alone: NuisanceFit, chosen: Subset) -> Subset:
    """Return the best set with one hypothesis of another class, or () if it is far behind.

    The nuisances are those fitted alone, so that they favour neither set.
    """
    candidates, found = model.candidates, dict[Subset, float]()
    for index, one in enumerate(chosen):
        others = (*chosen[:index], *chosen[index + 1 :])
        order, _ = rank_additions(candidates, alone.rhs, others)
        runner_up = next((h for h in order if candidates.label[h] != candidates.label[one]), None)
        if runner_up is not None:
            instead = (*chosen[:index], runner_up, *chosen[index + 1 :])
            found[instead] = subset_neg_log10_p(candidates, alone.rhs, instead)
    best = max(found, key=found.__getitem__, default=())
    return (
        best
        if best and found[best] > (1.0 - RUNNER_UP_SHARE) * subset_neg_log10_p(candidates, alone.rhs, chosen)
        else ()
    )


def _iterate(
    model: DiagnosisModel,
    start: NuisanceFit,
    patch: tuple[Effect, ...],
    beside: Callable[[NuisanceFit], Subset],
) -> NuisanceFit:
    """Resimulate until the nuisances beside some effects converge, or no effect is left."""
    current = start
    least = MIN_CHANGE_SIGMAS * np.array([nuisance.sigma for nuisance in model.sensitivities.nuisances])
    for update in range(MAX_UPDATES):
        if update and not current.selection.chosen:
            break
        arm, estimated = current.simulator.arm, _estimate_nuisances(model, current, beside(current))
        difference = estimated - current.nuisance
        moved = arm.effects({}, np.where(np.abs(difference) > least, difference, 0.0))
        if not moved:
            break
        near, otherwise = (*patch, *arm.effects({}, estimated)), model.sensitivities.nuisance @ difference
        current = _select_from(
            model, resimulate(current.simulator, near, AffectedMotions(tuple(moved)), otherwise), estimated
        )
    return current


def _select_from(model: DiagnosisModel, simulator: CaseSimulator, nuisance: Array) -> NuisanceFit:
    residual = simulator.residual() + model.sensitivities.nuisance @ nuisance
    rhs, y = reduce_residuals(model.equations, Residuals(model.sensitivities.layout, residual))
    selection = select_effects(model.candidates, rhs)
    k = model.equations.columns(selection.chosen).size
    needed = float(chi2.isf(10.0**-model.thresholds.effect, k)) if k else 0.0
    null_deviance = residual_deviance(model.equations, y)
    return NuisanceFit(
        simulator,
        nuisance,
        residual,
        rhs,
        selection,
        null_deviance,
        null_deviance - selection.likelihood_ratio + needed,
    )


def _estimate_nuisances(model: DiagnosisModel, current: NuisanceFit, beside: Subset) -> Array:
    """Estimate the nuisances beside some effects, (q,), limited to MAX_SIGMAS.

    Random and one-sided nuisances stay 0.
    """
    equations = model.equations
    fit = fit_linear(equations, current.rhs, equations.columns(beside))
    found = np.zeros(len(model.sensitivities.nuisances))
    found[model.sensitivities.shared_nuisances] = fit.theta[: equations.q] * equations.nuisance_unit
    far = MAX_SIGMAS * np.array([nuisance.sigma for nuisance in model.sensitivities.nuisances])
    return np.where(
        [one.one_sided for one in current.simulator.arm.nuisance_effects], 0.0, np.clip(found, -far, far)
    )
