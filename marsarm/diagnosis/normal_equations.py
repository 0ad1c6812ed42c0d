"""Normal equations of the linear model, with nuisances eliminated, and the fit to a case.

The whitened model is y = N v + S a + e with e of unit covariance. The nuisances v are in units
of their sigma, so that their prior has unit covariance too. They are eliminated by the Schur
complement:

    R = S'S - S'N (N'N + 1)^-1 N'S

Shapes use m features, q shared nuisances and k columns of h hypotheses.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from marsarm.diagnosis.problem import FeatureLayout, Ints
from marsarm.diagnosis.sensitivity import Sensitivities

ABSORBED_SHARE: Final = 1e-6
"""A column counts as not identifiable if the nuisances leave less than this share of its square."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockCovariance:
    """Low-rank covariance by nuisances: of the features of a block, if random per block, or of all."""

    rows: Ints
    """Indices of the features, shape (n,)."""
    U: Array
    """Orthonormal directions, shape (n, s)."""
    shrinkage: Array
    """Share by which whitening reduces each direction, shape (s,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """Linear map that makes the noise of the features independent and of unit variance."""

    sigma: Array
    scatter: tuple[BlockCovariance, ...]

    def __call__(self, X: Array) -> Array:
        """Whiten features in the units of their channels, shape (m,) or (m, n)."""
        Z = (X.T / self.sigma).T
        for block in self.scatter:
            part = Z[block.rows]
            Z[block.rows] = part - (block.U * block.shrinkage) @ (block.U.T @ part)
        return Z


def build_whitener(sensitivities: Sensitivities) -> Whitener:
    """Build the whitener from the noise floor and the nuisances that are random per block."""
    layout = sensitivities.layout
    drawn = [index for index, nuisance in enumerate(sensitivities.nuisances) if nuisance.random_per_block]
    if not drawn:
        return Whitener(layout.sigma, ())
    sigma = np.array([sensitivities.nuisances[index].sigma for index in drawn])
    L = sensitivities.nuisance[:, drawn] * sigma / layout.sigma[:, None]
    scatter = []
    for block in range(len(layout.blocks)):
        rows = np.flatnonzero(layout.block == block)
        if rows.size and np.any(L[rows]):
            scatter.append(_block_covariance(rows, L[rows]))
    return Whitener(layout.sigma, tuple(scatter))


def build_full_whitener(sensitivities: Sensitivities) -> Whitener:
    """Build the whitener from the noise floor and all nuisances with their priors."""
    first = build_whitener(sensitivities)
    N = _nuisance_columns(sensitivities, first)
    shared = _block_covariance(np.arange(len(N)), N)
    return Whitener(first.sigma, (*first.scatter, shared))


def _block_covariance(rows: Ints, L: Array) -> BlockCovariance:
    """Return the covariance L L' of some features beside unit noise, L (n, s)."""
    U, S, _ = np.linalg.svd(L, full_matrices=False)
    return BlockCovariance(rows, U, 1.0 - 1.0 / np.sqrt(1.0 + S**2))


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Normal equations of a campaign; they do not depend on measured data.

    Columns are scaled so that an amplitude a of 1 is one standard error, with nuisances free.
    """

    layout: FeatureLayout
    owner: Ints
    """Index of the hypothesis that each column belongs to, shape (k,)."""
    whiten: Whitener
    N: Array
    """Whitened nuisances, shape (m, q)."""
    S: Array
    """Whitened columns, shape (m, k)."""
    nuisance_sigma: Array
    """Sigma of each shared nuisance in its own unit, shape (q,)."""
    R: Array
    """Information of the columns with nuisances eliminated, shape (k, k)."""
    scale: Array
    """Standard errors per typical size, shape (k,); 0 for a column that is not identifiable."""

    @property
    def q(self) -> int:
        """Number of shared nuisances."""
        return self.nuisance_sigma.size

    @property
    def identifiable(self) -> Flags:
        """Flags of the hypotheses whose columns are all identifiable beside the nuisances, shape (h,)."""
        hidden = np.zeros(self.owner[-1] + 1, bool)
        hidden[self.owner[self.scale == 0.0]] = True
        return ~hidden


def form_normal_equations(sensitivities: Sensitivities) -> NormalEquations:
    """Form the normal equations of all hypotheses; columns that are not identifiable become 0."""
    whiten = build_whitener(sensitivities)
    N, S = _nuisance_columns(sensitivities, whiten), whiten(sensitivities.effect)
    across = N.T @ S
    R = S.T @ S - across.T @ np.linalg.solve(N.T @ N + np.eye(N.shape[1]), across)
    information = np.diagonal(R)
    is_seen = information > ABSORBED_SHARE * np.sum(S**2, axis=0)
    scale = np.sqrt(np.where(is_seen, information, 0.0))
    by = np.where(is_seen, 1.0 / np.where(is_seen, scale, 1.0), 0.0)
    R = (R + R.T) / 2.0 * np.outer(by, by)
    sigma = _shared_sigma(sensitivities)
    return NormalEquations(sensitivities.layout, sensitivities.owner, whiten, N, S * by, sigma, R, scale)


def _nuisance_columns(sensitivities: Sensitivities, whiten: Whitener) -> Array:
    """Whiten the columns of the shared nuisances, in units of their sigma, (m, q)."""
    return whiten(sensitivities.nuisance[:, sensitivities.shared_nuisances]) * _shared_sigma(sensitivities)


def _shared_sigma(sensitivities: Sensitivities) -> Array:
    return np.array([sensitivities.nuisances[index].sigma for index in sensitivities.shared_nuisances])


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Nuisances and chosen columns, fitted together."""

    A: Array
    """Fitted columns: whitened nuisances, then the chosen ones, shape (m, n)."""
    theta: Array
    """Fitted values, shape (n,): nuisances in sigmas, amplitudes in standard errors."""
    covariance: Array
    """Posterior covariance, shape (n, n)."""


def fit_linear(equations: NormalEquations, y: Array, chosen: Collection[int]) -> LinearFit:
    """Fit nuisances and chosen hypotheses by maximum posterior; singular combinations stay at 0.

    Args:
        y: Whitened features, without a unit, shape (m,).
        chosen: Indices of hypotheses.
    """
    A = np.hstack([equations.N, equations.S[:, np.isin(equations.owner, list(chosen))]])
    prior = np.where(np.arange(A.shape[1]) < equations.q, 1.0, 0.0)
    covariance = np.linalg.pinv(A.T @ A + np.diag(prior), rcond=1e-13, hermitian=True)
    return LinearFit(A, covariance @ (A.T @ y), covariance)
