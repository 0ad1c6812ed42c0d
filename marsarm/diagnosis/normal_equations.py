"""Normal equations of the linear model, with nuisances eliminated, and the fit to a case.

The whitened model is y = N v + S a + e with A = [N S] and e of unit covariance. The nuisances v have a
Gaussian prior of precision P. With G = A'A and c = A'y, the nuisances are eliminated by the Schur complement:

    C = (G_NN + P)^-1
    W = G_SN C
    R = G_SS - W G_NS
    r = c_S - W c_N

The amplitudes a solve R a = r. Shapes use m features, q shared nuisances and k columns of h hypotheses.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from marsarm.diagnosis.problem import FeatureLayout, Hypothesis, Ints
from marsarm.diagnosis.sensitivity import Sensitivities

ABSORBED_SHARE: Final = 1e-6
"""A column counts as not identifiable if the nuisances leave less than this share of its square."""
FLAT_PRIOR_SHARE: Final = 1e-9
"""Prior precision of a nuisance with infinite sigma, as a share of its information in all data."""


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
        """Whiten features.

        Args:
            X: Features in the units of their channels, shape (m,) or (m, n).

        Returns:
            Whitened features, same shape.
        """
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
    N, prior, _ = nuisance_columns(sensitivities, first)
    shared = _block_covariance(np.arange(len(N)), N / np.sqrt(prior))
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
    hypotheses: tuple[Hypothesis, ...]
    owner: Ints
    """Index of the hypothesis that each column belongs to, shape (k,)."""
    whiten: Whitener
    A: Array
    """Whitened nuisances and columns, [N S], shape (m, q + k)."""
    G: Array
    """Normal matrix A'A, shape (q + k, q + k)."""
    prior: Array
    """Prior precision P of the nuisances, shape (q,)."""
    nuisance_unit: Array
    """Size of 1 of each nuisance in its own unit: its sigma if that is finite, shape (q,)."""
    R: Array
    """Information of the columns with nuisances eliminated, shape (k, k)."""
    W: Array
    """Elimination matrix G_SN C, shape (k, q)."""
    C: Array
    """Covariance of the nuisances without effects, shape (q, q)."""
    scale: Array
    """Standard errors per typical size, shape (k,); 0 for a column that is not identifiable."""

    @property
    def q(self) -> int:
        """Number of shared nuisances."""
        return self.prior.size

    @property
    def identifiable(self) -> Flags:
        """Flags of the hypotheses whose columns are all identifiable beside the nuisances, shape (h,)."""
        hidden = np.zeros(len(self.hypotheses), bool)
        hidden[self.owner[self.scale == 0.0]] = True
        return ~hidden

    def columns(self, chosen: tuple[int, ...]) -> Ints:
        """Return the columns of some hypotheses, in the order of the hypotheses given."""
        return np.concatenate([np.flatnonzero(self.owner == h) for h in chosen] or [np.zeros(0, np.intp)])


def form_normal_equations(sensitivities: Sensitivities) -> NormalEquations:
    """Form the normal equations of all hypotheses, with nuisances eliminated.

    Returns:
        Normal equations with columns in units of their standard error.
    """
    whiten = build_whitener(sensitivities)
    N, prior, unit = nuisance_columns(sensitivities, whiten)
    A = np.hstack([N, whiten(sensitivities.effect)])
    G = A.T @ A
    return _scale_columns(NormalEquations(
        sensitivities.layout, sensitivities.hypotheses, sensitivities.owner, whiten, A, G, prior, unit,
        *_eliminate_nuisances(G, prior), np.ones(sensitivities.owner.size),
    ))  # fmt: skip


def nuisance_columns(sensitivities: Sensitivities, whiten: Whitener) -> tuple[Array, Array, Array]:
    """Whiten the columns of the shared nuisances.

    Returns:
        Columns in the units of the nuisances, (m, q), prior precisions, (q,), and these units, (q,): sigma if
        it is finite.
    """
    sigma = np.array([sensitivities.nuisances[index].sigma for index in sensitivities.shared_nuisances])
    known = np.isfinite(sigma)
    N = whiten(sensitivities.nuisance[:, sensitivities.shared_nuisances])
    norm = np.linalg.norm(N, axis=0)
    unit = np.where(known, sigma, 1.0 / np.where(norm == 0.0, 1.0, norm))
    return N * unit, np.where(known, 1.0, FLAT_PRIOR_SHARE), unit


def _eliminate_nuisances(G: Array, prior: Array) -> tuple[Array, Array, Array]:
    """Return R, W and C; see the module."""
    q = prior.size
    C = np.linalg.inv(G[:q, :q] + np.diag(prior))
    W = G[q:, :q] @ C
    R = G[q:, q:] - W @ G[:q, q:]
    return np.asarray((R + R.T) / 2.0), W, np.asarray(C, np.float64)


def _scale_columns(raw: NormalEquations) -> NormalEquations:
    """Scale the columns to units of their standard error; set those that are not identifiable to 0."""
    q, of = raw.q, np.diagonal(raw.R)
    scale = np.sqrt(np.where(of > ABSORBED_SHARE * np.diagonal(raw.G)[q:], of, 0.0))
    by = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    all_by = np.concatenate([np.ones(q), by])
    G, R = raw.G * np.outer(all_by, all_by), raw.R * np.outer(by, by)
    return replace(raw, A=raw.A * all_by, G=G, R=R, W=raw.W * by[:, None], scale=scale)


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
