"""Normal equations of the linear model, with nuisances eliminated, and the right-hand sides of cases.

The whitened model is y = N v + S a + e with A = [N S] and e of unit covariance. The nuisances v have a
Gaussian prior of precision P. For each block b, G_b = A_b'A_b and c_b = A_b'y_b. Summed over blocks, the
nuisances are eliminated by the Schur complement:

    C = (G_NN + P)^-1
    W = G_SN C
    R = G_SS - W G_NS
    r = c_S - W c_N

The amplitudes a solve R a = r. The folds of the cross-validation leave out one block each; the last fold has
all blocks. Shapes use m features, q shared nuisances, k columns of h hypotheses, b blocks and f = b + 1
folds.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.problem import FeatureLayout, Hypothesis, Ints, Residuals
from ground.diagnosis.sensitivity import Sensitivities

ABSORBED_SHARE: Final = 1e-6
"""A column counts as not identifiable if the nuisances leave less than this share of its square."""
FLAT_PRIOR_SHARE: Final = 1e-9
"""Prior precision of a nuisance with infinite sigma, as a share of its information in all data."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockCovariance:
    """Low-rank covariance of the features of one block, from the nuisances that are random per block."""

    rows: Ints
    """Indices of the block's features, shape (n,)."""
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
            U, S, _ = np.linalg.svd(L[rows], full_matrices=False)
            scatter.append(BlockCovariance(rows, U, 1.0 - 1.0 / np.sqrt(1.0 + S**2)))
    return Whitener(layout.sigma, tuple(scatter))


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
    rows: tuple[Ints, ...]
    """Indices of the features of each block that has any, b arrays."""
    G: Array
    """Normal matrix A'A of each block, shape (b, q + k, q + k)."""
    prior: Array
    """Prior precision P of the nuisances, shape (q,)."""
    nuisance_unit: Array
    """Size of 1 of each nuisance in its own unit: its sigma if that is finite, shape (q,)."""
    R: Array
    """Information of the columns with nuisances eliminated, of each fold, shape (f, k, k)."""
    W: Array
    """Elimination matrix G_SN C of each fold, shape (f, k, q)."""
    C: Array
    """Covariance of the nuisances without effects, of each fold, shape (f, q, q)."""
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


def residual_deviance(equations: NormalEquations, y: Array) -> float:
    """Compute the deviance that remains when only the nuisances are fitted.

    Args:
        equations: Normal equations of the campaign.
        y: Whitened features, shape (m,).

    Returns:
        Minimum over v of |y - N v|^2 + v'P v.
    """
    along = equations.A[:, : equations.q].T @ y
    return float(y @ y - along @ equations.C[-1] @ along)


def form_normal_equations(sensitivities: Sensitivities) -> NormalEquations:
    """Form the normal equations of all hypotheses, with nuisances eliminated.

    Args:
        sensitivities: Sensitivities of the campaign.

    Returns:
        Normal equations with columns in units of their standard error.
    """
    layout = sensitivities.layout
    whiten = build_whitener(sensitivities)
    N, prior, unit = _nuisance_columns(sensitivities, whiten)
    A = np.hstack([N, whiten(sensitivities.effect)])
    rows = tuple(np.flatnonzero(layout.block == b) for b in np.unique(layout.block))
    G = np.array([A[of].T @ A[of] for of in rows])
    return _scale_columns(NormalEquations(
        layout, sensitivities.hypotheses, sensitivities.owner, whiten, A, rows, G, prior, unit,
        *_eliminate_nuisances(G, prior), np.ones(sensitivities.owner.size),
    ))  # fmt: skip


def _nuisance_columns(sensitivities: Sensitivities, whiten: Whitener) -> tuple[Array, Array, Array]:
    """Return whitened columns (m, q), prior precisions (q,), and the unit of each nuisance (q,)."""
    sigma = np.array([sensitivities.nuisances[index].sigma for index in sensitivities.shared_nuisances])
    known = np.isfinite(sigma)
    N = whiten(sensitivities.nuisance[:, sensitivities.shared_nuisances])
    norm = np.linalg.norm(N, axis=0)
    unit = np.where(known, sigma, 1.0 / np.where(norm == 0.0, 1.0, norm))
    return N * unit, np.where(known, 1.0, FLAT_PRIOR_SHARE), unit


def _eliminate_nuisances(G: Array, prior: Array) -> tuple[Array, Array, Array]:
    """Return R, W and C of every fold; see the module."""
    q, total = prior.size, G.sum(axis=0)
    folds = np.concatenate([total - G, total[None]])
    C = np.linalg.inv(folds[:, :q, :q] + np.diag(prior))
    W = folds[:, q:, :q] @ C
    R = folds[:, q:, q:] - W @ folds[:, :q, q:]
    return (R + R.transpose(0, 2, 1)) / 2.0, W, C


def _scale_columns(raw: NormalEquations) -> NormalEquations:
    """Scale the columns to units of their standard error; set those that are not identifiable to 0."""
    q, of = raw.q, np.diagonal(raw.R[-1])
    before = np.einsum("bkk->k", raw.G[:, q:, q:])
    scale = np.sqrt(np.where(of > ABSORBED_SHARE * before, of, 0.0))
    by = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    all_by = np.concatenate([np.ones(q), by])
    return NormalEquations(
        raw.layout, raw.hypotheses, raw.owner, raw.whiten, raw.A * all_by, raw.rows,
        raw.G * np.outer(all_by, all_by), raw.prior, raw.nuisance_unit, raw.R * np.outer(by, by),
        raw.W * by[:, None], raw.C, scale,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class RightHandSide:
    """Right-hand side of the normal equations: the data of one case."""

    c: Array
    """Products A'y of each block, shape (b, q + k)."""
    r: Array
    """Products of the columns with nuisances eliminated, of each fold, shape (f, k)."""

    @property
    def all(self) -> Array:
        """Products of all blocks together, shape (k,)."""
        return np.asarray(self.r[-1])


def reduce_features(equations: NormalEquations, y: Array) -> RightHandSide:
    """Form the right-hand side from features.

    Args:
        equations: Normal equations of the campaign.
        y: Whitened features, shape (m,).

    Returns:
        Right-hand side of all folds.
    """
    return reduce_block_sums(equations, np.array([y[rows] @ equations.A[rows] for rows in equations.rows]))


def reduce_block_sums(equations: NormalEquations, c: Array) -> RightHandSide:
    """Form the right-hand side from the products of each block.

    Args:
        equations: Normal equations of the campaign.
        c: Whitened products A'y of each block, shape (b, n) with n = q + k.

    Returns:
        Right-hand side of all folds.
    """
    q, total = equations.q, c.sum(axis=0)
    folds = np.concatenate([total - c, total[None]])
    r = folds[:, q:] - np.einsum("fkq,fq->fk", equations.W, folds[:, :q])
    return RightHandSide(c, r)


def reduce_residuals(equations: NormalEquations, residuals: Residuals) -> tuple[RightHandSide, Array]:
    """Whiten residuals and form their right-hand side.

    Args:
        equations: Normal equations of the campaign.
        residuals: Residuals in the units of the channels.

    Returns:
        Right-hand side, and whitened features of shape (m,).
    """
    y = equations.whiten(residuals.value)
    return reduce_features(equations, y), y
