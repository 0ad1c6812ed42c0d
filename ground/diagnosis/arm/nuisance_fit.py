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
"""Sigmas by which a nuisance must have moved for the simulator to be asked again."""
MAX_SIGMAS: Final = 10.0
"""Sigmas up to which it is asked: what an effect makes of a nuisance that is like it may be no arm at all."""
MAX_UPDATES: Final = 3
RUNNER_UP_SHARE: Final = 0.2
"""Of the surprise, the share by which a rival may fall short before it has nuisances of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class NuisanceFit:
    """The simulator asked about some nuisances, and what explains the case in straight lines from there."""

    simulator: CaseSimulator
    nuisance: Array
    """(q,)."""
    residual: Array
    """Measured less simulated with nuisances at 0, in straight lines from where they are, (m,)."""
    rhs: RightHandSide
    selection: Selection
    null_deviance: float
    """Deviance that nuisances alone leave."""
    cost: float
    """Deviance that is left beside what won, and what as many effects without a cause would explain."""
    comparison: ModelComparison | None = None
    """Between what won and what explains it nearly as well."""


def fit_nuisances(model: DiagnosisModel, first: CaseSimulator, patch: tuple[Effect, ...]) -> NuisanceFit:
    """The nuisances settled alone, and if there is an effect all the same, beside it.

    Alone they would take the place of an effect that they are like. That they bend may still be the simpler
    explanation.
    """
    first_look = _select_from(model, first, np.zeros(len(first.nuisances)))
    alone = _iterate(model, first_look, patch, lambda _: ())
    if not alone.selection.chosen:
        return alone
    beside = _iterate(model, alone, patch, lambda current: current.selection.chosen)
    if not beside.selection.chosen:
        return beside
    # what wins from `alone` has nuisances elsewhere, so only what is left there without it can be believed
    return _compare_runner_up(model, alone, beside, patch) if beside.cost < alone.null_deviance else alone


def _compare_runner_up(
    model: DiagnosisModel, alone: NuisanceFit, beside: NuisanceFit, patch: tuple[Effect, ...]
) -> NuisanceFit:
    """What won or what comes nearest to it, each beside nuisances of its own: the more surprising one."""
    rival = _find_runner_up(model, alone, beside.selection.chosen)
    if not rival:
        return beside
    try:
        return _compare_by_simulation(model, alone, beside, rival, patch)
    except PlantDiverged:  # there is no such arm, so it explains nothing
        return beside


def _compare_by_simulation(
    model: DiagnosisModel, alone: NuisanceFit, beside: NuisanceFit, rival: Subset, patch: tuple[Effect, ...]
) -> NuisanceFit:
    there = _iterate(model, alone, patch, lambda _: rival)
    if not there.selection.chosen:  # where the rival would be, nothing may be the simpler explanation
        return there if there.null_deviance < beside.cost else beside
    chosen = beside.selection.chosen
    current = _iterate(model, beside, patch, lambda _: chosen)
    ours, mine = _fit_simulated(model, current, chosen, alone.null_deviance)
    theirs, other = _fit_simulated(model, there, rival, alone.null_deviance)
    if other > mine:
        return replace(
            there, comparison=ModelComparison(rival, theirs, chosen, deviance_difference(other - mine))
        )
    if not np.isfinite(mine):
        return beside
    return replace(
        current, comparison=ModelComparison(chosen, ours, rival, deviance_difference(mine - other))
    )


def _fit_simulated(
    model: DiagnosisModel, current: NuisanceFit, chosen: Subset, before: float
) -> tuple[NonlinearFit, float]:
    """Some effects with the simulator, where nuisances are, and the surprise of what they explain.

    Of a deviance `before`. What is at a bound is no finding, and surprises nobody: -inf.
    """
    fit = fit_subset(model, model.equations.whiten(current.residual), current.rhs, chosen, current.simulator)
    if any(fit.at_bound):
        return fit, -np.inf
    k = model.equations.columns(chosen).size
    return fit, float(neg_log10_p(np.array(max(before - fit.cost, 0.0)), k))


def _find_runner_up(model: DiagnosisModel, alone: NuisanceFit, chosen: Subset) -> Subset:
    """The best with another class in place of one of them, where nuisances favour neither; or nothing."""
    candidates, found = model.candidates, dict[Subset, float]()
    for index, one in enumerate(chosen):
        others = (*chosen[:index], *chosen[index + 1 :])
        order, _ = rank_additions(candidates, alone.rhs, others)
        rival = next((h for h in order if candidates.label[h] != candidates.label[one]), None)
        if rival is not None:
            instead = (*chosen[:index], rival, *chosen[index + 1 :])
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
    """Until nuisances stay where they are beside some effects, or leave no effect to be found."""
    current = start
    least = MIN_CHANGE_SIGMAS * np.array([nuisance.sigma for nuisance in model.sensitivities.nuisances])
    for asked_before in range(MAX_UPDATES):
        if asked_before and not current.selection.chosen:
            break
        arm, there = current.simulator.arm, _estimate_nuisances(model, current, beside(current))
        by = there - current.nuisance
        moved = arm.effects({}, np.where(np.abs(by) > least, by, 0.0))
        if not moved:
            break
        near, otherwise = (*patch, *arm.effects({}, there)), model.sensitivities.nuisance @ by
        current = _select_from(
            model, resimulate(current.simulator, near, AffectedMotions(tuple(moved)), otherwise), there
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
    """As they are beside some effects, (q,), within what can be asked.

    Those that are drawn in every block, and those that cannot be had in parts, stay 0.
    """
    equations = model.equations
    fit = fit_linear(equations, current.rhs, equations.columns(beside))
    found = np.zeros(len(model.sensitivities.nuisances))
    found[model.sensitivities.shared_nuisances] = fit.theta[: equations.q] * equations.nuisance_unit
    far = MAX_SIGMAS * np.array([nuisance.sigma for nuisance in model.sensitivities.nuisances])
    return np.where(
        [one.one_sided for one in current.simulator.arm.nuisance_effects], 0.0, np.clip(found, -far, far)
    )
