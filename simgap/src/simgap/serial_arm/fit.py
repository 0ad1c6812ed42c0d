"""Weighted least squares with priors; identifiability, outliers, and validation on held-out poses.

Values of parameters are arrays (p,) in their units, and 0 where a fit starts by default. `used` flags the
poses to fit, (n,), by default all.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from simgap.arrays import Array, Flags, Integers
from simgap.common.errors import RobotError

NO_PRIOR: Final = np.inf
"""Prior sigma of a parameter without prior knowledge."""
STEP_TOLERANCE: Final = 1e-7
"""Iteration ends when no parameter changes by more than this share of its scale."""
MAX_ITERATIONS: Final = 50
DAMPING: Final = 1e-6
"""First damping if a full step increases the cost, as a share of the information's largest eigenvalue."""
DAMPING_FACTOR: Final = 10.0
MAX_DAMPING: Final = 1e3
MIN_SENSITIVITY: Final = 1e-2
"""Smallest effect of a combination of parameters, in sigmas of the noise per scale.

Combinations with a smaller effect keep their values.
"""
MAX_UNCONSTRAINED: Final = 1e-6
"""A parameter with a larger share in unconstrained combinations has no finite sigma."""


@dataclass(frozen=True, slots=True)
class FitParameter:
    """Parameter of a fit, as a difference from its prior value."""

    name: str
    unit: str
    scale: float
    """Typical size in the unit of the parameter; it makes parameters of different units comparable."""
    prior_sigma: float = NO_PRIOR
    """Standard deviation of the prior, which has its mean at 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Linearisation:
    """Residuals of all poses at given parameter values, with their derivatives.

    Both are whitened: the noise is independent, with unit variance in every component.
    """

    residual: Array
    """Whitened residuals, shape (poses, components)."""
    jacobian: Array
    """Exact derivatives of the residuals, shape (poses, components, parameters)."""

    @property
    def is_informative(self) -> Flags:
        """Flag the components that depend on any parameter, shape (poses, components)."""
        return np.asarray(np.any(self.jacobian != 0.0, axis=-1))

    def at(self, poses: Flags) -> "Linearisation":
        """Select some of the poses."""
        return Linearisation(self.residual[poses], self.jacobian[poses])


ResidualModel = Callable[[Array], Linearisation]
"""Function from parameter values, shape (p,), to the linearisation candidate."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Result of a fit."""

    parameters: tuple[FitParameter, ...]
    values: Array
    """Parameter values, shape (p,)."""
    covariance: Array
    """Covariance of the values, prior included, shape (p, p).

    Combinations that neither data nor prior determine are left out.
    """
    unconstrained: Array
    """Share of each parameter in undetermined combinations, 0 to 1, shape (p,)."""
    at: Linearisation
    """Linearisation of all poses at the values."""
    used: Flags
    """Flags of the fitted poses, shape (n,)."""
    converged: bool
    iterations: int

    @property
    def sigma(self) -> Array:
        """Compute the sigma of each parameter, (p,); infinite if neither data nor prior determine it."""
        return np.where(self.unconstrained > MAX_UNCONSTRAINED, np.inf, np.sqrt(np.diag(self.covariance)))

    @property
    def chi_square(self) -> float:
        """Compute the sum of squared residuals of the fitted poses."""
        return float(np.sum(self.at.residual[self.used] ** 2))

    @property
    def degrees_of_freedom(self) -> float:
        """Compute the expected chi-square: measured components less the effective number of parameters."""
        J = _flat(self.at.jacobian[self.used])
        return int(self.at.is_informative[self.used].sum()) - float(np.sum((J @ self.covariance) * J))

    @property
    def sigma0(self) -> float:
        """Compute the reduced standard deviation of the residuals; 1 if model and noise are right."""
        return float(np.sqrt(self.chi_square / self.degrees_of_freedom))

    @property
    def p_value(self) -> float:
        """Compute the probability of a chi-square at least this large if model and noise are right."""
        return float(chi2.sf(self.chi_square, self.degrees_of_freedom))

    def index(self, name: str) -> int:
        """Return the index of a parameter among the values; ValueError if there is none."""
        return [parameter.name for parameter in self.parameters].index(name)


def fit(
    parameters: Sequence[FitParameter],
    model: ResidualModel,
    start: Array | None = None,
    used: Flags | None = None,
) -> Fit:
    """Fit parameters by damped Gauss-Newton iteration."""
    scale = np.array([parameter.scale for parameter in parameters])
    prior = 1.0 / np.array([parameter.prior_sigma for parameter in parameters])
    x = np.zeros(scale.size) if start is None else start
    at = model(x)
    keep = np.ones(at.residual.shape[0], bool) if used is None else used
    converged, iterations = False, 0
    while not converged and iterations < MAX_ITERATIONS:
        iterations += 1
        step, at = _damped_step(model, x, at, keep, scale, prior)
        x = x + step
        converged = bool(np.all(np.abs(step) <= STEP_TOLERANCE * scale))
    information, _ = _normal_equations(at, x, keep, scale, prior)
    s2, V = np.linalg.eigh(information)
    determined = s2 > MIN_SENSITIVITY**2
    root = scale[:, None] * V[:, determined] / np.sqrt(s2[determined])
    unconstrained = np.sqrt(np.maximum(0.0, 1.0 - np.sum(V[:, determined] ** 2, axis=1)))
    return Fit(tuple(parameters), x, root @ root.T, unconstrained, at, keep, converged, iterations)


def cost(at: Linearisation, used: Flags, x: Array, prior: Array) -> float:
    """Compute the sum of squares that the fit minimises, with inverse prior sigmas, (p,)."""
    return float(np.sum(at.residual[used] ** 2) + np.sum((x * prior) ** 2))


def _damped_step(
    model: ResidualModel, x: Array, at: Linearisation, used: Flags, scale: Array, prior: Array
) -> tuple[Array, Linearisation]:
    """Find a step that does not increase the cost; damp it only if the full step increases the cost."""
    information, gradient = _normal_equations(at, x, used, scale, prior)
    s2, V = np.linalg.eigh(information)
    determined = s2 > MIN_SENSITIVITY**2
    along = V.T @ gradient
    before, damping = cost(at, used, x, prior), 0.0
    while damping <= MAX_DAMPING:
        step = -scale * (V @ np.where(determined, along / (s2 + damping * s2[-1] + ~determined), 0.0))
        candidate = model(x + step)
        if cost(candidate, used, x + step, prior) <= before * (1 + STEP_TOLERANCE):
            return step, candidate
        damping = max(DAMPING, DAMPING_FACTOR * damping)
    return np.zeros_like(x), at


def _normal_equations(
    at: Linearisation, x: Array, used: Flags, scale: Array, prior: Array
) -> tuple[Array, Array]:
    """Compute information (p, p) and gradient (p,), prior included, in units of the scales."""
    J = _flat(at.jacobian[used]) * scale
    gradient: Array = J.T @ at.residual[used].ravel() + scale * prior**2 * x
    return J.T @ J + np.diag((prior * scale) ** 2), gradient


def _flat(jacobian: Array) -> Array:
    """Stack the rows of all poses."""
    return jacobian.reshape(-1, jacobian.shape[-1])


class BlockEquations:
    """Normal equations of a fit in units of the scales, by block of time."""

    def __init__(self, fitted: Fit, n_blocks: int):
        self.fit = fitted
        self.scale = np.array([one.scale for one in fitted.parameters])
        prior = self.scale / np.array([one.prior_sigma for one in fitted.parameters])
        self.J = fitted.at.jacobian[fitted.used] * self.scale
        self.r = fitted.at.residual[fitted.used]
        self.block: Integers = np.arange(len(self.r)) * n_blocks // len(self.r)
        parts = [self.block == k for k in range(n_blocks)]
        self.H = np.array([_flat(self.J[part]).T @ _flat(self.J[part]) for part in parts])
        self.g = np.array([_flat(self.J[part]).T @ self.r[part].ravel() for part in parts])
        self.penalty = np.diag(prior**2 + MIN_SENSITIVITY**2)
        self.pull = prior**2 * fitted.values / self.scale


@dataclass(frozen=True, slots=True, eq=False)
class HoldOutValidation:
    """Residuals of held-out poses, and their variance by noise and covariance of the fit; whitened.

    Uninformative components are 0 in both.
    """

    residual: Array
    """Residuals, shape (poses, components)."""
    variance: Array
    """Expected variances, shape (poses, components)."""

    @property
    def ratio(self) -> float:
        """Compute the root mean square residual over its expected value."""
        return float(np.sqrt(np.sum(self.residual**2) / np.sum(self.variance)))


def validate_hold_out(fitted: Fit, fresh: Linearisation) -> HoldOutValidation:
    """Compare residuals of held-out poses, linearised at the fitted values, with their expected variance."""
    J = fresh.jacobian
    learnt = np.einsum("nij,jk,nik->ni", J, fitted.covariance, J, optimize=True)
    return HoldOutValidation(fresh.residual, fresh.is_informative + learnt)


MIN_SIGMAS: Final = 10.0
"""A combination is identified if a change by its scale shows this many sigmas in all poses together."""
MIN_SHARE: Final = 0.02
"""A parameter belongs to an unidentified combination if this squared share of it does."""
MIN_CORRELATION: Final = 0.05
"""Parameters belong to one group if they correlate by more than this within the unidentified subspace."""


@dataclass(frozen=True, slots=True)
class UnidentifiableGroup:
    """Parameters of which only some combinations are identified."""

    names: tuple[str, ...]
    identified: int
    """Number of identified combinations."""


@dataclass(frozen=True, slots=True, eq=False)
class Identifiability:
    """Identified and unidentified combinations of parameters."""

    parameters: tuple[FitParameter, ...]
    singular_values: Array
    """Singular values of the whitened Jacobian in units of the scales, in descending order, shape (p,)."""
    combinations: Array
    """Right singular vectors in units of the scales, one in each column, shape (p, p)."""

    @property
    def rank(self) -> int:
        """Return the number of identified combinations."""
        return int(np.count_nonzero(self.singular_values > MIN_SIGMAS))

    @property
    def condition(self) -> float:
        """Return the condition number of the identified combinations."""
        return float(self.singular_values[0] / self.singular_values[self.rank - 1]) if self.rank else np.inf

    def unidentifiable_groups(self) -> tuple[UnidentifiableGroup, ...]:
        """Group the parameters that are confounded or have no effect; none is in two groups."""
        unseen = self.combinations[:, self.rank :]
        projector = unseen @ unseen.T
        share = np.diag(projector)
        part = np.flatnonzero(share > MIN_SHARE)
        together = np.abs(projector) > MIN_CORRELATION * np.sqrt(np.outer(share, share))
        count, label = connected_components(together[np.ix_(part, part)])
        return tuple(self._group(part[label == k], projector) for k in range(count))

    def _group(self, group: Integers, projector: Array) -> UnidentifiableGroup:
        unseen = round(float(np.trace(projector[np.ix_(group, group)])))
        return UnidentifiableGroup(tuple(self.parameters[k].name for k in group), group.size - unseen)


def assess_identifiability(
    parameters: Sequence[FitParameter], at: Linearisation, used: Flags | None = None
) -> Identifiability:
    """Assess which combinations of parameters some poses identify."""
    jacobian = at.jacobian if used is None else at.jacobian[used]
    scale = np.array([parameter.scale for parameter in parameters])
    J = jacobian.reshape(-1, scale.size) * scale
    # R of the QR decomposition has the same singular values and directions, and far fewer rows
    few = J if J.shape[0] < scale.size else np.linalg.qr(J, mode="r")
    _, s, Vt = np.linalg.svd(few, full_matrices=True)
    values = np.zeros(scale.size)
    values[: s.size] = s
    return Identifiability(tuple(parameters), values, Vt.T)


FALSE_ALARM: Final = 0.01
"""Probability of reporting an outlier in a campaign without outliers."""
MAX_OUTLIER_SHARE: Final = 0.2
"""Largest share of poses that may be outliers; if there are more, the model is wrong."""


def leave_one_out_distance(fitted: Fit) -> Array:
    """Compute the squared distance over variance, (n,), of each pose from a fit to the other poses.

    For poses that were not fitted, the fit itself predicts.
    """
    J, r = fitted.at.jacobian, fitted.at.residual
    hat = np.einsum("nij,jk,nlk->nil", J, fitted.covariance, J, optimize=True)
    sign = np.where(fitted.used, -1.0, 1.0)[:, None, None]
    # a fitted pose pulls the fit towards itself, which reduces the variance of its residual
    variance = np.eye(r.shape[1]) + sign * hat
    return np.asarray(np.einsum("ni,ni->n", r, np.linalg.solve(variance, r[..., None])[..., 0]))


REJECTION_FACTOR: Final = 4.0
"""Outliers within this factor of the worst are left out together."""
MOST_ROUNDS: Final = 20


def fit_without_outliers(
    parameters: Sequence[FitParameter],
    model: ResidualModel,
    start: Array | None = None,
    used: Flags | None = None,
    false_alarm: float = FALSE_ALARM,
) -> Fit:
    """Fit, and leave out the poses that do not agree with the others; RobotError if too many do not.

    A series may hold thousands of poses, so similarly bad outliers are left out together. Poses that agree
    with the next fit are included again. If all poses have more noise than stated, the limit rises, so that
    no outliers appear. Poses with fewer informative components have a lower limit.
    """
    found = fit(parameters, model, start, used)
    selected = found.used
    count = int(np.count_nonzero(selected))
    for _ in range(MOST_ROUNDS):
        components = np.maximum(found.at.is_informative.sum(axis=1), 1)
        distance = leave_one_out_distance(found)
        typical = max(1.0, float(np.median((distance / chi2.median(components))[found.used])))
        share = distance / (typical * chi2.isf(false_alarm / count, components))
        agree = selected & (share <= max(1.0, float(share[found.used].max()) / REJECTION_FACTOR))
        if np.array_equal(agree, found.used):
            break
        if np.count_nonzero(selected & ~agree) > MAX_OUTLIER_SHARE * count:
            raise RobotError(
                f"more than {MAX_OUTLIER_SHARE:.0%} of {count} poses do not agree with the rest: no arm "
                "explains them all; see that this is the arm of the file, and that the tracker kept its "
                "target"
            )
        found = fit(parameters, model, found.values, agree)
    return found
