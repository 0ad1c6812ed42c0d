"""Linear fit of nuisances and chosen columns to a case."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.normal_equations import NormalEquations
from marsarm.diagnosis.problem import Ints


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Nuisances and chosen columns, fitted together."""

    active: Ints
    """Indices of the fitted columns of `NormalEquations.A`: all nuisances, then the chosen columns, shape
    (n,)."""
    theta: Array
    """Fitted values, shape (n,): nuisances in `nuisance_unit`, amplitudes in standard errors."""
    covariance: Array
    """Posterior covariance, shape (n, n)."""


def fit_linear(equations: NormalEquations, y: Array, columns: Ints) -> LinearFit:
    """Fit nuisances and chosen columns by maximum posterior; singular combinations stay at 0.

    Args:
        equations: Normal equations of the campaign.
        y: Whitened features, without a unit, shape (m,).
        columns: Indices of columns of effects.

    Returns:
        The fit.
    """
    active = np.concatenate([np.arange(equations.q), equations.q + columns])
    information = equations.G[np.ix_(active, active)]
    information[: equations.q, : equations.q] += np.diag(equations.prior)
    covariance = np.linalg.pinv(information, rcond=1e-13, hermitian=True)
    return LinearFit(active, covariance @ (equations.A[:, active].T @ y), covariance)


def whitened_residual(equations: NormalEquations, fit: LinearFit, y: Array) -> Array:
    """Compute the residual of a fit.

    Args:
        equations: Normal equations of the campaign.
        fit: Linear fit to these features.
        y: Whitened features, shape (m,).

    Returns:
        Whitened residual, shape (m,).
    """
    return np.asarray(y - equations.A[:, fit.active] @ fit.theta)
