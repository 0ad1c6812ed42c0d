"""What data say, reduced to what fits need: one case, or many at once."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.problem import FeatureLayout, Hypothesis, Ints, Residuals
from ground.diagnosis.sensitivity import Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class BlockCovariance:
    """What the features of one block share by chance."""

    rows: Ints
    """Its features, (n,)."""
    U: Array
    """Directions, (n, s)."""
    shrinkage: Array
    """By which share each of them is to be reduced, (s,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """Makes the noise of the features independent and of variance 1."""

    sigma: Array
    scatter: tuple[BlockCovariance, ...]

    def __call__(self, X: Array) -> Array:
        """The same in whitened features, (m,) or (m, n)."""
        Z = (X.T / self.sigma).T
        for block in self.scatter:
            part = Z[block.rows]
            Z[block.rows] = part - (block.U * block.shrinkage) @ (block.U.T @ part)
        return Z


def build_whitener(sensitivities: Sensitivities) -> Whitener:
    """Of the floor and of the nuisances that are drawn anew in every block."""
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


ABSORBED_SHARE: Final = 1e-6
"""A column of which the nuisances leave less than this share of its square is not seen."""
FLAT_PRIOR_SHARE: Final = 1e-9
"""Precision of a nuisance of which nothing is known, as a share of what all data say of it."""


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """A campaign ready for data: B blocks, q nuisances, K columns of H hypotheses, F = B + 1 folds."""

    layout: FeatureLayout
    hypotheses: tuple[Hypothesis, ...]
    owner: Ints
    """Which hypothesis each column belongs to, (K,)."""
    whiten: Whitener
    A: Array
    """Whitened nuisances and columns, [N S], (m, q + K)."""
    rows: tuple[Ints, ...]
    """The features of each block that has any, (B)."""
    G: Array
    """(B, q + K, q + K)."""
    prior: Array
    """P, (q,)."""
    nuisance_unit: Array
    """What 1 is of each nuisance, in its own unit: its sigma, if it has one, (q,)."""
    R: Array
    """(F, K, K)."""
    W: Array
    """(F, K, q)."""
    C: Array
    """Covariance of the nuisances if there is no effect, (F, q, q)."""
    scale: Array
    """How many standard errors a typical size is, (K,); 0 for a column that is not seen."""
    bounds: Array
    """Least and most of each column in standard errors, (2, K)."""

    @property
    def q(self) -> int:
        """Number of nuisances that are one number for all blocks."""
        return self.prior.size

    @property
    def identifiable(self) -> Flags:
        """Hypotheses of which every column shows beside the nuisances, (H,)."""
        hidden = np.zeros(len(self.hypotheses), bool)
        hidden[self.owner[self.scale == 0.0]] = True
        return ~hidden

    def columns(self, chosen: tuple[int, ...]) -> Ints:
        """The columns of some hypotheses, in the order of the hypotheses given."""
        return np.concatenate([np.flatnonzero(self.owner == h) for h in chosen] or [np.zeros(0, np.intp)])


def residual_deviance(equations: NormalEquations, y: Array) -> float:
    """Deviance of whitened features (m,) that nuisances alone leave, their prior counted."""
    along = equations.A[:, : equations.q].T @ y
    return float(y @ y - along @ equations.C[-1] @ along)


def form_normal_equations(
    sensitivities: Sensitivities, changed: dict[int, Array] | None = None
) -> NormalEquations:
    """Sums over blocks and what they say of every hypothesis with nuisances free.

    `changed` holds other columns (m, k) for some hypotheses, by index: those linearised elsewhere than at
    neutral. Their first column is the whole change at an estimate, so that 1 means as estimated.
    """
    layout, changed = sensitivities.layout, changed or {}
    parts = [
        changed.get(h, sensitivities.effect[:, sensitivities.owner == h])
        for h in range(len(sensitivities.hypotheses))
    ]
    owner = np.repeat(np.arange(len(parts)), [part.shape[1] for part in parts])
    whiten = build_whitener(sensitivities)
    N, prior, unit = _nuisance_columns(sensitivities, whiten)
    S = whiten(np.hstack([np.zeros((layout.size, 0)), *parts]))
    A = np.hstack([N, S])
    rows = tuple(np.flatnonzero(layout.block == b) for b in np.unique(layout.block))
    G = np.array([A[of].T @ A[of] for of in rows])
    return _scale_columns(NormalEquations(
        layout, sensitivities.hypotheses, owner, whiten, A, rows, G, prior, unit,
        *_eliminate_nuisances(G, prior), np.ones(owner.size), _bounds(sensitivities, changed),
    ))  # fmt: skip


def _nuisance_columns(sensitivities: Sensitivities, whiten: Whitener) -> tuple[Array, Array, Array]:
    """Whitened columns (m, q), prior precisions (q,), and what 1 is of each (q,)."""
    sigma = np.array([sensitivities.nuisances[index].sigma for index in sensitivities.shared_nuisances])
    known = np.isfinite(sigma)
    N = whiten(sensitivities.nuisance[:, sensitivities.shared_nuisances])
    norm = np.linalg.norm(N, axis=0)
    unit = np.where(known, sigma, 1.0 / np.where(norm == 0.0, 1.0, norm))
    return N * unit, np.where(known, 1.0, FLAT_PRIOR_SHARE), unit


def _eliminate_nuisances(G: Array, prior: Array) -> tuple[Array, Array, Array]:
    """R, W and C of every fold, and of all blocks."""
    q, total = prior.size, G.sum(axis=0)
    folds = np.concatenate([total - G, total[None]])
    C = np.linalg.inv(folds[:, :q, :q] + np.diag(prior))
    W = folds[:, q:, :q] @ C
    R = folds[:, q:, q:] - W @ folds[:, :q, q:]
    return (R + R.transpose(0, 2, 1)) / 2.0, W, C


def _bounds(sensitivities: Sensitivities, changed: dict[int, Array]) -> Array:
    """In typical sizes, (2, K); a changed column has none: its estimate kept to them already."""
    limits: list[tuple[float, float]] = []
    for index, hypothesis in enumerate(sensitivities.hypotheses):
        if index in changed:
            limits += [(-np.inf, np.inf)] * changed[index].shape[1]
            continue
        for parameter in hypothesis.amplitudes:
            ends = [(end - parameter.absent) / parameter.typical for end in (parameter.least, parameter.most)]
            limits.append((min(ends), max(ends)))
    return np.array(limits).reshape(-1, 2).T


def _scale_columns(raw: NormalEquations) -> NormalEquations:
    """The same with columns in units of their standard error; those not seen are 0."""
    q, of = raw.q, np.diagonal(raw.R[-1])
    before = np.einsum("bkk->k", raw.G[:, q:, q:])
    scale = np.sqrt(np.where(of > ABSORBED_SHARE * before, of, 0.0))
    by = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    all_by = np.concatenate([np.ones(q), by])
    return NormalEquations(
        raw.layout, raw.hypotheses, raw.owner, raw.whiten, raw.A * all_by, raw.rows,
        raw.G * np.outer(all_by, all_by), raw.prior, raw.nuisance_unit, raw.R * np.outer(by, by),
        raw.W * by[:, None], raw.C, scale, raw.bounds * np.where(scale > 0.0, scale, 1.0),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class RightHandSide:
    """Data in the campaign's terms (see `prepared`)."""

    c: Array
    """[N S]'y of each block, (B, q + K)."""
    r: Array
    """What every fold says of the columns with nuisances free, (F, K)."""

    @property
    def all(self) -> Array:
        """What all blocks say, (K,)."""
        return np.asarray(self.r[-1])


def reduce_features(equations: NormalEquations, y: Array) -> RightHandSide:
    """Of whitened features (m,)."""
    return reduce_block_sums(equations, np.array([y[rows] @ equations.A[rows] for rows in equations.rows]))


def reduce_block_sums(equations: NormalEquations, c: Array) -> RightHandSide:
    """Of sums over blocks (B, q + K)."""
    q, total = equations.q, c.sum(axis=0)
    folds = np.concatenate([total - c, total[None]])
    r = folds[:, q:] - np.einsum("fkq,fq->fk", equations.W, folds[:, :q])
    return RightHandSide(c, r)


def reduce_residuals(equations: NormalEquations, residuals: Residuals) -> tuple[RightHandSide, Array]:
    """The case, and the whitened features (m,)."""
    y = equations.whiten(residuals.value)
    return reduce_features(equations, y), y
