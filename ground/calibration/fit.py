"""The most probable parameters: Gauss-Newton on whitened residuals, with what was believed as prior.

Paper equations 18 to 22, iterated: every pass solves the linear system of all poses, with one row more for
each parameter that has a prior. The sum of squares that is least is |r|^2 + |x / prior sigma|^2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags
from ground.calibration.problem import Linearised, Model, Parameter

STEP: Final = 1e-7
"""A pass that moves no parameter by more than this share of its scale is the last."""
MAX_PASSES: Final = 50
DAMPING: Final = 1e-6
"""Where a full step makes the sum larger: the first damping, as a share of the largest information."""
HARDER: Final = 10.0
MAX_DAMPING: Final = 1e3
UNSEEN: Final = 1e-2
"""A combination that, moved by its scale, shows less than this share of the noise stays where it was."""
FREE: Final = 1e-6
"""A parameter with a larger share in such combinations has no sigma."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The parameters that explain the poses best, and how well."""

    parameters: tuple[Parameter, ...]
    values: Array
    """(p,)."""
    covariance: Array
    """Of the values, prior included, (p, p). Combinations that neither data nor prior tell are not in it."""
    free: Array
    """How much of each parameter is in such combinations, 0 to 1, (p,)."""
    at: Linearised
    """At the values, all poses."""
    used: Flags
    """Poses that the fit is of, (n,)."""
    converged: bool
    passes: int

    @property
    def sigma(self) -> Array:
        """One sigma of each parameter, (p,); infinite where neither data nor prior tell."""
        return np.where(self.free > FREE, np.inf, np.sqrt(np.diag(self.covariance)))

    @property
    def chi_square(self) -> float:
        """Sum of the squared residuals of the poses used."""
        return float(np.sum(self.at.residual[self.used] ** 2))

    @property
    def freedom(self) -> float:
        """What that sum is expected to be: numbers measured less numbers learnt from them."""
        J = _flat(self.at.jacobian[self.used])
        return int(self.at.counted[self.used].sum()) - float(np.sum((J @ self.covariance) * J))

    @property
    def sigma0(self) -> float:
        """Noise of the residuals over the noise that they were whitened with: 1 if the model is right."""
        return float(np.sqrt(self.chi_square / self.freedom))

    @property
    def p_value(self) -> float:
        """Probability of residuals this large if model and noise are right."""
        return float(chi2.sf(self.chi_square, self.freedom))

    def index(self, name: str) -> int:
        """Where a parameter is among the values; ValueError if there is none of this name."""
        return [parameter.name for parameter in self.parameters].index(name)


def fit(
    parameters: Sequence[Parameter], model: Model, start: Array | None = None, used: Flags | None = None
) -> Fit:
    """Fit to the poses used (n,), all if not given, from starting values (p,), 0 if not given."""
    scale, prior = _scale(parameters), _prior(parameters)
    x = np.zeros(scale.size) if start is None else start
    at = model(x)
    keep = np.ones(at.residual.shape[0], bool) if used is None else used
    converged, passes = False, 0
    while not converged and passes < MAX_PASSES:
        passes += 1
        step, at = _improved(model, x, at, keep, scale, prior)
        x = x + step
        converged = bool(np.all(np.abs(step) <= STEP * scale))
    information, _ = _normal(at, x, keep, scale, prior)
    s2, V = np.linalg.eigh(information)
    told = s2 > UNSEEN**2
    root = scale[:, None] * V[:, told] / np.sqrt(s2[told])
    free = np.sqrt(np.maximum(0.0, 1.0 - np.sum(V[:, told] ** 2, axis=1)))
    return Fit(tuple(parameters), x, root @ root.T, free, at, keep, converged, passes)


def cost(at: Linearised, used: Flags, x: Array, prior: Array) -> float:
    """The sum of squares to be least; `prior` is one over the prior sigmas."""
    return float(np.sum(at.residual[used] ** 2) + np.sum((x * prior) ** 2))


def _improved(
    model: Model, x: Array, at: Linearised, used: Flags, scale: Array, prior: Array
) -> tuple[Array, Linearised]:
    """A step that does not make the sum larger, and the model there: damped only if the full one does."""
    information, gradient = _normal(at, x, used, scale, prior)
    s2, V = np.linalg.eigh(information)
    told = s2 > UNSEEN**2
    along = V.T @ gradient
    before, damping = cost(at, used, x, prior), 0.0
    while damping <= MAX_DAMPING:
        step = -scale * (V @ np.where(told, along / (s2 + damping * s2[-1] + ~told), 0.0))
        there = model(x + step)
        if cost(there, used, x + step, prior) <= before * (1 + STEP):
            return step, there
        damping = max(DAMPING, HARDER * damping)
    return np.zeros_like(x), at


def _normal(at: Linearised, x: Array, used: Flags, scale: Array, prior: Array) -> tuple[Array, Array]:
    """Information (p, p) and gradient (p,), prior included, with parameters in units of their scale."""
    J = _flat(at.jacobian[used]) * scale
    gradient: Array = J.T @ at.residual[used].ravel() + scale * prior**2 * x
    return J.T @ J + np.diag((prior * scale) ** 2), gradient


def _flat(jacobian: Array) -> Array:
    """Rows of all poses, one under the other."""
    return jacobian.reshape(-1, jacobian.shape[-1])


def _scale(parameters: Sequence[Parameter]) -> Array:
    return np.array([parameter.scale for parameter in parameters])


def _prior(parameters: Sequence[Parameter]) -> Array:
    """One over the prior sigmas."""
    return 1.0 / np.array([parameter.prior_sigma for parameter in parameters])
