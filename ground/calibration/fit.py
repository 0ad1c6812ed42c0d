"""A fit judged by poses that had no part in it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from fsw.kinematics.transforms import Array, Flags

NO_PRIOR: Final = np.inf
"""The prior sigma of what nothing is known about beforehand."""


@dataclass(frozen=True, slots=True)
class FitParameter:
    """One number to be found, as a difference from what is believed beforehand."""

    name: str
    unit: str
    scale: float
    """A typical size of it, in its unit: so that numbers of different units can be compared."""
    prior_sigma: float = NO_PRIOR
    """How far from what is believed it may be expected, one sigma about 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """Residuals of all poses at some values of the parameters, and how they change with them.

    Whitened: in units of the noise, which is independent and of variance 1 in every component.
    """

    residual: Array
    """(poses, components)."""
    jacobian: Array
    """Exact derivatives of the residuals, (poses, components, parameters)."""

    @property
    def is_informative(self) -> Flags:
        """Components that measure anything, (poses, components): what depends on nothing does not."""
        return np.asarray(np.any(self.jacobian != 0.0, axis=-1))

    def at(self, poses: Flags) -> "Linearisation":
        """Some of the poses."""
        return Linearisation(self.residual[poses], self.jacobian[poses])


ResidualModel = Callable[[Array], Linearisation]
"""From values (parameters,) to the residuals and their derivatives there."""


STEP_TOLERANCE: Final = 1e-7
"""A pass that moves no parameter by more than this share of its scale is the last."""
MAX_ITERATIONS: Final = 50
DAMPING: Final = 1e-6
"""Where a full step makes the sum larger: the first damping, as a share of the largest information."""
DAMPING_FACTOR: Final = 10.0
MAX_DAMPING: Final = 1e3
MIN_SENSITIVITY: Final = 1e-2
"""A combination that, moved by its scale, shows less than this share of the noise stays where it was."""
MAX_UNCONSTRAINED: Final = 1e-6
"""A parameter with a larger share in such combinations has no sigma."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The parameters that explain the poses best, and how well."""

    parameters: tuple[FitParameter, ...]
    values: Array
    """(p,)."""
    covariance: Array
    """Of the values, prior included, (p, p). Combinations that neither data nor prior tell are not in it."""
    unconstrained: Array
    """How much of each parameter is in such combinations, 0 to 1, (p,)."""
    at: Linearisation
    """At the values, all poses."""
    used: Flags
    """Poses that the fit is of, (n,)."""
    converged: bool
    iterations: int

    @property
    def sigma(self) -> Array:
        """One sigma of each parameter, (p,); infinite where neither data nor prior tell."""
        return np.where(self.unconstrained > MAX_UNCONSTRAINED, np.inf, np.sqrt(np.diag(self.covariance)))

    @property
    def chi_square(self) -> float:
        """Sum of the squared residuals of the poses used."""
        return float(np.sum(self.at.residual[self.used] ** 2))

    @property
    def degrees_of_freedom(self) -> float:
        """What that sum is expected to be: numbers measured less numbers learnt from them."""
        J = _flat(self.at.jacobian[self.used])
        return int(self.at.is_informative[self.used].sum()) - float(np.sum((J @ self.covariance) * J))

    @property
    def sigma0(self) -> float:
        """Noise of the residuals over the noise that they were whitened with: 1 if the model is right."""
        return float(np.sqrt(self.chi_square / self.degrees_of_freedom))

    @property
    def p_value(self) -> float:
        """Probability of residuals this large if model and noise are right."""
        return float(chi2.sf(self.chi_square, self.degrees_of_freedom))

    def index(self, name: str) -> int:
        """Where a parameter is among the values; ValueError if there is none of this name."""
        return [parameter.name for parameter in self.parameters].index(name)


def fit(
    parameters: Sequence[FitParameter],
    model: ResidualModel,
    start: Array | None = None,
    used: Flags | None = None,
) -> Fit:
    """Fit to the poses used (n,), all if not given, from starting values (p,), 0 if not given."""
    scale, prior = _scale(parameters), _prior_weights(parameters)
    x = np.zeros(scale.size) if start is None else start
    at = model(x)
    keep = np.ones(at.residual.shape[0], bool) if used is None else used
    converged, passes = False, 0
    while not converged and passes < MAX_ITERATIONS:
        passes += 1
        step, at = _damped_step(model, x, at, keep, scale, prior)
        x = x + step
        converged = bool(np.all(np.abs(step) <= STEP_TOLERANCE * scale))
    information, _ = _normal_equations(at, x, keep, scale, prior)
    s2, V = np.linalg.eigh(information)
    told = s2 > MIN_SENSITIVITY**2
    root = scale[:, None] * V[:, told] / np.sqrt(s2[told])
    free = np.sqrt(np.maximum(0.0, 1.0 - np.sum(V[:, told] ** 2, axis=1)))
    return Fit(tuple(parameters), x, root @ root.T, free, at, keep, converged, passes)


def cost(at: Linearisation, used: Flags, x: Array, prior: Array) -> float:
    """The sum of squares to be least; `prior` is one over the prior sigmas."""
    return float(np.sum(at.residual[used] ** 2) + np.sum((x * prior) ** 2))


def _damped_step(
    model: ResidualModel, x: Array, at: Linearisation, used: Flags, scale: Array, prior: Array
) -> tuple[Array, Linearisation]:
    """A step that does not make the sum larger, and the model there: damped only if the full one does."""
    information, gradient = _normal_equations(at, x, used, scale, prior)
    s2, V = np.linalg.eigh(information)
    told = s2 > MIN_SENSITIVITY**2
    along = V.T @ gradient
    before, damping = cost(at, used, x, prior), 0.0
    while damping <= MAX_DAMPING:
        step = -scale * (V @ np.where(told, along / (s2 + damping * s2[-1] + ~told), 0.0))
        there = model(x + step)
        if cost(there, used, x + step, prior) <= before * (1 + STEP_TOLERANCE):
            return step, there
        damping = max(DAMPING, DAMPING_FACTOR * damping)
    return np.zeros_like(x), at


def _normal_equations(
    at: Linearisation, x: Array, used: Flags, scale: Array, prior: Array
) -> tuple[Array, Array]:
    """Information (p, p) and gradient (p,), prior included, with parameters in units of their scale."""
    J = _flat(at.jacobian[used]) * scale
    gradient: Array = J.T @ at.residual[used].ravel() + scale * prior**2 * x
    return J.T @ J + np.diag((prior * scale) ** 2), gradient


def _flat(jacobian: Array) -> Array:
    """Rows of all poses, one under the other."""
    return jacobian.reshape(-1, jacobian.shape[-1])


def _scale(parameters: Sequence[FitParameter]) -> Array:
    return np.array([parameter.scale for parameter in parameters])


def _prior_weights(parameters: Sequence[FitParameter]) -> Array:
    """One over the prior sigmas."""
    return 1.0 / np.array([parameter.prior_sigma for parameter in parameters])


@dataclass(frozen=True, slots=True, eq=False)
class HoldOutValidation:
    """What fresh poses were off by, and what noise and the fit's covariance let expect; whitened.

    Components that measure nothing are 0 in both.
    """

    residual: Array
    """(poses, components)."""
    variance: Array
    """Expected, (poses, components)."""

    @property
    def ratio(self) -> float:
        """Root mean square over what was expected."""
        return float(np.sqrt(np.sum(self.residual**2) / np.sum(self.variance)))


def validate_hold_out(fitted: Fit, fresh: Linearisation) -> HoldOutValidation:
    """Judge by poses linearised at the fit's values."""
    J = fresh.jacobian
    learnt = np.einsum("nij,jk,nik->ni", J, fitted.covariance, J, optimize=True)
    return HoldOutValidation(fresh.residual, fresh.is_informative + learnt)
