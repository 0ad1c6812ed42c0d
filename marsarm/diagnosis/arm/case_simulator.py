"""Simulators of the arm of a campaign, and of one case in the order of its features; nuisances of the case.

A case may lack features of the campaign, or have others. Repeats of a motion got the same drive, so only the
first of them is simulated.

Nuisance parameters can be large and act nonlinearly, so linearisation error can look like an effect. So the
case is simulated again at the estimated nuisances until they converge. Fitted alone, they can imitate an
effect; fitted beside it, they give way to it. So they are fitted alone first, and beside the selected effects
then.

In all functions, features and their changes are arrays in the units of their channels, (m,) or (n,) as in
`CaseSimulator`; `nuisance` is their change per unit of each nuisance, (m, q).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.arm_effects import moves
from marsarm.diagnosis.arm.feature_set import FeatureSet, lay_out, measure_features, simulate_features
from marsarm.diagnosis.arm.features import MotionFeatures
from marsarm.diagnosis.model import DiagnosisModel, Whitener, build_full_whitener, fit_linear
from marsarm.diagnosis.problem import CONDITIONS, LOG_UNIT, Departures, FeatureLayout, Ints
from marsarm.diagnosis.selection import FeatureSelection, select, select_simulated
from sim.effects.effect import Effect
from sim.plant import PlantDiverged
from simgap.selection.chance import FALSE_ALARM

MOTION_CONDITIONS: Final = tuple(
    CONDITIONS.index(name) for name in ("speed", "sine of the angle", "cosine of the angle", "direction")
)
MOTION_TOLERANCE: Final = 0.02
"""Greatest difference of speed [rad/s], sine and cosine of an angle, for the same motion in two logs."""
MIN_CHANGE_SIGMAS: Final = 0.5
"""Sigmas by which a nuisance must change for a resimulation: the linear model is exact to second order."""
MIN_CURVED: Final = 0.25
"""Second-order change of a feature, in noise floors, for which its motion is simulated again; else it is
extrapolated. Rests are always solved again."""
MAX_SIGMAS: Final = 10.0
"""Greatest simulated departure: an effect can push a similar nuisance beyond any real arm."""
MAX_UPDATES: Final = 3
"""Greatest number of resimulations of nuisances alone, and of those beside effects."""


@dataclass(frozen=True, slots=True, eq=False)
class CaseSimulator:
    """Simulator of a case in m features of a campaign.

    It uses the nominal arm. Flight parameters do not change it, only effects do.
    """

    feature_set: FeatureSet
    patch: tuple[Effect, ...]
    """Effects that are always on."""
    layout: FeatureLayout
    """Layout of the m features, with the noise floor of the case."""
    floor_notes: tuple[str, ...]
    """Notes on the origin of that."""
    measured: Array
    """All n measured features of the case in the units of the channels, shape (n,)."""
    nominal: Array
    """Prediction of these under its own drive, shape (n,)."""
    at: Ints
    """Index of each of the m features among those n, shape (m,)."""
    rows: Ints
    """Index of each of the m features among the campaign's, ascending, shape (m,)."""
    nuisance: Array
    """Nuisances of the prediction in their units, shape (q,)."""

    def simulate(self, departures: Departures) -> Array:
        """Return the change by effects, as `marsarm.diagnosis.problem.Simulate`."""
        effects = tuple(one.switch_on(a) for one, a in departures.items())
        try:
            return simulate_change(self.feature_set, effects, self.nominal, self.patch)[self.at]
        except PlantDiverged:
            return np.full(self.at.size, np.nan)

    def residual(self, nuisance: Array) -> Array:
        """Return measured minus predicted features, extrapolated linearly to nuisances at 0."""
        return np.asarray((self.measured - self.nominal)[self.at] + nuisance @ self.nuisance)


def build_case_simulator(
    feature_set: FeatureSet, layout: FeatureLayout, n_nuisances: int, patch: tuple[Effect, ...] = ()
) -> CaseSimulator:
    """Simulate a case, and bind the simulator to the features that case and campaign share.

    A feature with the same key is dropped if it belongs to another motion: at another angle or speed.
    The nominal prediction of the campaign would not do for a case: a placement that begins a few cycles
    later shifts a start by a part of a bin, and its mean current by many noise floors.
    """
    (own, notes), predicted = lay_out(feature_set), simulate_features(feature_set, patch)
    _, rows, at = np.intersect1d(layout.key, own.key, return_indices=True)
    rows, at = np.sort(rows), at[np.argsort(rows)]
    difference = np.abs(own.condition[at] - layout.condition[rows])[:, list(MOTION_CONDITIONS)]
    same = np.all(difference < MOTION_TOLERANCE, axis=1) & np.isfinite(predicted[at])
    rows, at = rows[same], at[same]
    measured, nuisance = measure_features(feature_set), np.zeros(n_nuisances)
    return CaseSimulator(feature_set, patch, own.select(at), notes, measured, predicted, at, rows, nuisance)


def resimulate(
    case: CaseSimulator, patch: tuple[Effect, ...], only: Callable[[MotionFeatures], bool], otherwise: Array
) -> CaseSimulator:
    """Simulate a case again with another patch: its rests, and some motions; others change by `otherwise`."""
    simulated, extrapolated = simulate_features(case.feature_set, patch, only), case.nominal.copy()
    extrapolated[case.at] += otherwise
    return replace(case, patch=patch, nominal=np.where(np.isfinite(simulated), simulated, extrapolated))


def simulate_change(
    feature_set: FeatureSet, effects: tuple[Effect, ...], nominal: Array, patch: tuple[Effect, ...] = ()
) -> Array:
    """Simulate the change by effects from a prediction without them; 0 in motions that they do not change.

    The effects of the patch are on in both. PlantDiverged if MuJoCo counted a warning.
    """
    every = *patch, *effects
    change = simulate_features(feature_set, every, lambda one: any(moves(e, one) for e in effects)) - nominal
    return np.where(np.isfinite(change), change, 0.0)


def fit_nuisances(
    model: DiagnosisModel, first: CaseSimulator, seed: int
) -> tuple[CaseSimulator, FeatureSelection]:
    """Fit the nuisances alone, and if an effect remains, beside the effect; start at nominal nuisances.

    The nonlinear response of nuisances alone can be the simpler explanation, so the lower deviance wins, in
    which effects have to pay for their parameters. Large effects are simulated before: their linear response
    would lose against nuisances beyond any real arm.
    """
    whiten, slopes = build_full_whitener(model.sensitivities), model.sensitivities.nuisance
    alone = beside = _fit_alone(model, whiten, first)
    before = selection = select(model, model.sensitivities, whiten, alone.residual(slopes), seed)
    if not before.chosen:
        return alone, before
    chosen = tuple[int, ...]()
    for _ in range(MAX_UPDATES):
        if set(selection.chosen) == set(chosen):
            break
        chosen = selection.chosen
        moved = _update(model, beside, chosen, first.patch)
        if moved is beside:
            break
        beside = moved
        selection = select_simulated(model, whiten, beside.residual(slopes), seed, beside.simulate)
    cost = _cost(whiten, beside.residual(slopes), selection)
    if beside is not alone and selection.chosen and cost < _deviance(whiten, alone.residual(slopes)):
        return beside, selection
    return alone, select_simulated(model, whiten, alone.residual(slopes), seed, alone.simulate)


def _fit_alone(model: DiagnosisModel, whiten: Whitener, first: CaseSimulator) -> CaseSimulator:
    """Fit the nuisances alone while the deviance falls: a simulated motor may stall where a real one ran."""
    current, slopes = first, model.sensitivities.nuisance
    for _ in range(MAX_UPDATES):
        moved = _update(model, current, (), first.patch)
        before, after = (_deviance(whiten, one.residual(slopes)) for one in (current, moved))
        if moved is current or after > before:
            break
        current = moved
    return current


def _deviance(whiten: Whitener, residual: Array) -> float:
    white = whiten(residual)
    return float(white @ white)


def _update(
    model: DiagnosisModel, current: CaseSimulator, beside: tuple[int, ...], patch: tuple[Effect, ...]
) -> CaseSimulator:
    """Simulate at the nuisances estimated beside some effects; the same case if they have converged."""
    sensitivities = model.sensitivities
    estimated = _estimate_nuisances(model, current, beside)
    difference = estimated - current.nuisance
    if not np.any(np.abs(difference) > MIN_CHANGE_SIGMAS * sensitivities.sigma):
        return current
    # a factor exp(d) changes a feature by its slope times d + d^2 / 2 + ..; all else is nearly linear
    is_factor = np.array([nuisance.unit == LOG_UNIT for nuisance in sensitivities.nuisances])
    second_order = sensitivities.nuisance @ (np.where(is_factor, difference, 0.0) ** 2 / 2.0)
    layout = sensitivities.layout
    blocks = {*layout.block[np.abs(second_order) > MIN_CURVED * layout.sigma].tolist()}
    pairs = zip(sensitivities.nuisances, estimated.tolist(), strict=True)
    near = (*patch, *(one.effect(value) for one, value in pairs if value and one.effect is not None))
    otherwise = sensitivities.nuisance @ difference
    again = resimulate(current, near, lambda one: one.recording.block in blocks, otherwise)
    return replace(again, nuisance=estimated)


def _cost(whiten: Whitener, residual: Array, selection: FeatureSelection) -> float:
    """Return the deviance beside the selected effects, plus the threshold for as many parameters.

    The whitener is that of the model, so that deviances of several selections can be compared.
    """
    k = sum(a.size for a in selection.departures.values())
    needed = float(chi2.isf(FALSE_ALARM / max(selection.engine.context.n_distinct, 1.0), k)) if k else 0.0
    return _deviance(whiten, residual - selection.sensitivities.change(selection.departures)) + needed


def _estimate_nuisances(model: DiagnosisModel, current: CaseSimulator, beside: tuple[int, ...]) -> Array:
    """Estimate the nuisances beside some effects, (q,), limited to MAX_SIGMAS.

    Random nuisances and numerical errors stay 0.
    """
    equations, sensitivities = model.equations, model.sensitivities
    residual, shared = current.residual(sensitivities.nuisance), sensitivities.shared_nuisances
    fit = fit_linear(equations, equations.whiten(residual), beside)
    found, far = np.zeros(len(sensitivities.nuisances)), MAX_SIGMAS * sensitivities.sigma
    found[shared] = fit.theta[: equations.q] * sensitivities.sigma[shared]
    return np.where(
        [bool(one.only_channel) for one in sensitivities.nuisances], 0.0, np.clip(found, -far, far)
    )
