"""Baseline methods on the same features as the diagnosis, for comparison in the score.

`largest_error` takes the place of the largest residual for the cause. `everything_free` fits all effects at
once. `gaussian_process` predicts held-out residuals without naming a cause.
"""

from typing import Any, Final

import numpy as np
from mujoco.minimize import Verbosity, least_squares
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from fsw.kinematics.transforms import Array
from ground.diagnosis.closure import whitened_closure
from ground.diagnosis.linear_fit import RIDGE_SHARE
from ground.diagnosis.normal_equations import NormalEquations, RightHandSide, reduce_features
from ground.diagnosis.problem import FeatureLayout
from ground.diagnosis.result import finite_or_none
from validation.blind.case_features import HeldOutTrial, no_change

MAX_FEATURES: Final = 400
"""Greatest number of features of a channel that a Gaussian process is fitted to; evenly thinned."""
MAX_BOUND_SIGMAS: Final = 1e6
"""Limit of all bounds in standard errors, beyond any bound that matters."""
LENGTH_SCALE_RANGE: Final = (0.1, 100.0)
"""Range of the kernel's length scale, in standard deviations of the conditions."""


def largest_error(layout: FeatureLayout, residual: Array) -> str:
    """Return the place with the largest mean square residual.

    Args:
        layout: Description of the m features.
        residual: Residual in units of the noise floor, shape (m,).
    """
    count = np.bincount(layout.place, minlength=len(layout.places))
    square = np.bincount(layout.place, residual**2, minlength=len(layout.places))
    return layout.places[int(np.argmax(square / np.maximum(count, 1)))]


def everything_free(equations: NormalEquations, case: RightHandSide) -> tuple[int, Array]:
    """Fit all hypotheses at once within their bounds, by the least squares that mujoco.sysid uses.

    Args:
        equations: Normal equations of the campaign.
        case: Right-hand side of the case.

    Returns:
        Hypothesis with the largest t'R t of its own columns, and all amplitudes in typical sizes, shape (k,).
    """
    columns = np.flatnonzero(equations.scale > 0.0)
    R = equations.R[-1][np.ix_(columns, columns)]
    t = np.zeros(equations.owner.size)
    L = np.linalg.cholesky(R + RIDGE_SHARE * np.eye(columns.size))
    wanted = np.linalg.solve(L, case.all[columns])[:, None]
    bounds = [
        np.clip(end, -MAX_BOUND_SIGMAS, MAX_BOUND_SIGMAS)[:, None] for end in equations.bounds[:, columns]
    ]
    x, _ = least_squares(
        np.zeros((columns.size, 1)),
        lambda x: L.T @ x - wanted,
        bounds,
        jacobian=lambda _x, _r: L.T,
        verbose=Verbosity.SILENT,
    )
    t[columns] = x[:, 0]
    own = [
        t[at] @ equations.R[-1][np.ix_(at, at)] @ t[at]
        for at in (np.flatnonzero(equations.owner == h) for h in range(len(equations.hypotheses)))
    ]
    by = np.where(equations.scale > 0.0, 1.0 / np.where(equations.scale > 0.0, equations.scale, 1.0), 0.0)
    return int(np.argmax(own)), t * by


def gaussian_process(layout: FeatureLayout, residual: Array, held_out: FeatureLayout) -> Array:
    """Predict held-out residuals with one Gaussian process for each channel, over the conditions.

    The noise is 1. The kernel is s^2 exp(-|x - x'|^2 / 2 l^2) of standardised conditions; s and l maximise
    the marginal likelihood.

    Args:
        layout: Description of the m fitted features.
        residual: Residual in units of the noise floor, shape (m,).
        held_out: Description of the n held-out features.

    Returns:
        Predicted residual in units of the noise floor, shape (n,).
    """
    result = np.zeros(held_out.size)
    for number, channel in enumerate(held_out.channels):
        if channel not in layout.channels:
            continue
        rows = np.flatnonzero(layout.channel == layout.channels.index(channel))
        there = held_out.channel == number
        if not rows.size or not there.any():
            continue
        rows = rows[:: -(-rows.size // MAX_FEATURES)]
        middle, spread = layout.condition[rows].mean(axis=0), layout.condition[rows].std(axis=0)
        spread = np.where(spread > 0.0, spread, 1.0)
        x, new = ((of - middle) / spread for of in (layout.condition[rows], held_out.condition[there]))
        result[there] = _predict_channel(x, residual[rows], new)
    return result


def _predict_channel(x: Array, y: Array, new: Array) -> Array:
    """Predict one channel with the most likely kernel."""
    square, across = _squares(x, x), _squares(new, x)

    def cost(log: Array) -> float:
        K = np.exp(2.0 * log[0] - square / (2.0 * np.exp(2.0 * log[1]))) + np.eye(y.size)
        factor = cho_factor(K, lower=True)
        return float(0.5 * y @ cho_solve(factor, y) + np.log(np.diag(factor[0])).sum())

    limits = ((np.log(1e-3), np.log(1e3)), tuple(np.log(LENGTH_SCALE_RANGE)))
    log = minimize(cost, np.zeros(2), bounds=limits, options={"maxiter": 30}).x
    K = np.exp(2.0 * log[0] - square / (2.0 * np.exp(2.0 * log[1]))) + np.eye(y.size)
    weights = cho_solve(cho_factor(K, lower=True), y)
    return np.asarray(np.exp(2.0 * log[0] - across / (2.0 * np.exp(2.0 * log[1]))) @ weights)


def _squares(a: Array, b: Array) -> Array:
    """Return squared distances, (n, m)."""
    return np.asarray(np.sum((a[:, None, :] - b[None, :, :]) ** 2, axis=-1))


def baselines(case: HeldOutTrial, seed: int) -> dict[str, dict[str, Any]]:
    """Return the results of all baseline methods on a case."""
    rest, before = case.left(no_change)
    found, layout = case.fitted.sensitivities, case.held.sensitivities.layout
    equations = case.equations
    most, sizes = everything_free(equations, reduce_features(equations, equations.whiten(case.fitted.value)))
    named = found.hypotheses[most]
    free = case.closed(lambda of: np.asarray(of.effect @ sizes), seed)
    whitened = case.held_out_model.whiten(before)
    process = whitened_closure(
        case.held_out_model, whitened, whitened - gaussian_process(found.layout, rest, layout), seed
    )
    return {
        "largest_error": {"place": largest_error(found.layout, rest)},
        "everything_free": {
            "name": named.effect,
            "place": named.place,
            "closure": finite_or_none(free.share),
        },
        "gaussian_process": {"closure": finite_or_none(process.share)},
    }
