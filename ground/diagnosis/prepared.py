"""All of a campaign that can be computed before there are data.

The model is y = N v + S t + e, whitened, with nuisances v of prior precision P. Sums over a block b are
G_b = [N S]'[N S]; a fit to some blocks needs only their sum. With v free, what those blocks say of t is

    R = G_SS - W G_NS,    r = c_S - W c_N,    W = G_SN (G_NN + P)^-1,    c = [N S]'y,

and the deviance of t, from that of no effect, is t'R t - 2 r't: thousands of fits are small solves. R and W
are kept for every fold (all blocks but one) and, last, for all blocks. Columns are scaled so that R of all
blocks has a diagonal of 1: sizes are then in units of their own standard error, and no choice depends on
units.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.hypothesis import Hypothesis
from ground.diagnosis.layout import Ints, Layout
from ground.diagnosis.sensitivity import Sensitivities
from ground.diagnosis.whiten import Whitener, whitener

ABSORBED: Final = 1e-6
"""A column of which the nuisances leave less than this share of its square is not seen."""
VAGUE: Final = 1e-9
"""Precision of a nuisance of which nothing is known, as a share of what all data say of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A campaign ready for data: B blocks, q nuisances, K columns of H hypotheses, F = B + 1 folds."""

    layout: Layout
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
    def seen(self) -> Flags:
        """Hypotheses of which every column shows beside the nuisances, (H,)."""
        hidden = np.zeros(len(self.hypotheses), bool)
        hidden[self.owner[self.scale == 0.0]] = True
        return ~hidden

    def columns(self, chosen: tuple[int, ...]) -> Ints:
        """The columns of some hypotheses, in the order of the hypotheses given."""
        return np.concatenate([np.flatnonzero(self.owner == h) for h in chosen] or [np.zeros(0, np.intp)])


def left_over(prepared: Prepared, y: Array) -> float:
    """Deviance of whitened features (m,) that nuisances alone leave, their prior counted."""
    along = prepared.A[:, : prepared.q].T @ y
    return float(y @ y - along @ prepared.C[-1] @ along)


def prepare(found: Sensitivities, changed: dict[int, Array] | None = None) -> Prepared:
    """Sums over blocks and what they say of every hypothesis with nuisances free.

    `changed` holds other columns (m, k) for some hypotheses, by index: those linearised elsewhere than at
    neutral. Their first column is the whole change at an estimate, so that 1 means as estimated.
    """
    layout, changed = found.layout, changed or {}
    parts = [changed.get(h, found.effect[:, found.owner == h]) for h in range(len(found.hypotheses))]
    owner = np.repeat(np.arange(len(parts)), [part.shape[1] for part in parts])
    whiten = whitener(found)
    N, prior, unit = _nuisances(found, whiten)
    S = whiten(np.hstack([np.zeros((layout.size, 0)), *parts]))
    A = np.hstack([N, S])
    rows = tuple(np.flatnonzero(layout.block == b) for b in np.unique(layout.block))
    G = np.array([A[of].T @ A[of] for of in rows])
    return _scaled(Prepared(
        layout, found.hypotheses, owner, whiten, A, rows, G, prior, unit,
        *_free(G, prior), np.ones(owner.size), _bounds(found, changed),
    ))  # fmt: skip


def _nuisances(found: Sensitivities, whiten: Whitener) -> tuple[Array, Array, Array]:
    """Whitened columns (m, q), prior precisions (q,), and what 1 is of each (q,)."""
    sigma = np.array([found.nuisances[index].sigma for index in found.lasting])
    known = np.isfinite(sigma)
    N = whiten(found.nuisance[:, found.lasting])
    norm = np.linalg.norm(N, axis=0)
    unit = np.where(known, sigma, 1.0 / np.where(norm == 0.0, 1.0, norm))
    return N * unit, np.where(known, 1.0, VAGUE), unit


def _free(G: Array, prior: Array) -> tuple[Array, Array, Array]:
    """R, W and C of every fold, and of all blocks."""
    q, total = prior.size, G.sum(axis=0)
    folds = np.concatenate([total - G, total[None]])
    C = np.linalg.inv(folds[:, :q, :q] + np.diag(prior))
    W = folds[:, q:, :q] @ C
    R = folds[:, q:, q:] - W @ folds[:, :q, q:]
    return (R + R.transpose(0, 2, 1)) / 2.0, W, C


def _bounds(found: Sensitivities, changed: dict[int, Array]) -> Array:
    """In typical sizes, (2, K); a changed column has none: its estimate kept to them already."""
    limits: list[tuple[float, float]] = []
    for index, hypothesis in enumerate(found.hypotheses):
        if index in changed:
            limits += [(-np.inf, np.inf)] * changed[index].shape[1]
            continue
        for parameter in hypothesis.sizes:
            ends = [(end - parameter.absent) / parameter.typical for end in (parameter.least, parameter.most)]
            limits.append((min(ends), max(ends)))
    return np.array(limits).reshape(-1, 2).T


def _scaled(raw: Prepared) -> Prepared:
    """The same with columns in units of their standard error; those not seen are 0."""
    q, of = raw.q, np.diagonal(raw.R[-1])
    before = np.einsum("bkk->k", raw.G[:, q:, q:])
    scale = np.sqrt(np.where(of > ABSORBED * before, of, 0.0))
    by = np.where(scale > 0.0, 1.0 / np.where(scale > 0.0, scale, 1.0), 0.0)
    all_by = np.concatenate([np.ones(q), by])
    return Prepared(
        raw.layout, raw.hypotheses, raw.owner, raw.whiten, raw.A * all_by, raw.rows,
        raw.G * np.outer(all_by, all_by), raw.prior, raw.nuisance_unit, raw.R * np.outer(by, by),
        raw.W * by[:, None], raw.C, scale, raw.bounds * np.where(scale > 0.0, scale, 1.0),
    )  # fmt: skip
