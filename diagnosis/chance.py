"""Chance: probabilities of the scores of a screening if no effect is present, also with few motions.

Two tests. Sign flips of whole motions need seven motions or more. The Wald test works with fewer: its error
of a size comes from clusters, whose residuals may depend on one another in any way.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.special import betaincc
from scipy.stats import f as fisher

from diagnosis.arrays import Array, Integers

FALSE_ALARM: Final = 0.05
"""Largest probability of a name anywhere if no effect is present."""
DRAWS: Final = 2000
"""Random signs of the null distribution: its 5 % quantile is good to half a percent."""


def wald_p(basis: Array, change: Array, residual: Array, cluster: Integers) -> float:
    """Test whether the sizes of an effect are 0.

    The errors are CR2 (Bell and McCaffrey 2002): those of a cluster are enlarged by as much as the fit has
    followed it, and the degrees of freedom fall where few clusters decide. Several sizes are tested along
    their best combination by Hotelling's distribution, which bounds the test of all directions from above.

    Args:
        basis: Orthonormal changes by the base parameters, (n_rows, n_base), without a unit.
        change: Change by each size, (n_rows, n_sizes), orthogonal to the basis, without a unit.
        residual: Residuals before the effect, orthogonal to the basis, (n_rows,), without a unit.
        cluster: Cluster of each residual, (n_rows,), from 0.

    Returns:
        Probability of the statistic, or a larger one, if the sizes are 0.
    """
    left, sizes, _ = np.linalg.svd(change, full_matrices=False)
    own = left[:, sizes > 1e-8 * sizes[0]] if sizes.size and sizes[0] > 0.0 else left[:, :0]
    product = own.T @ residual
    strength = float(product @ product)
    if strength == 0.0:
        return 1.0
    x = np.hstack([basis, own])
    c = np.concatenate([np.zeros(basis.shape[1]), product / np.sqrt(strength)])
    rest = residual - own @ product
    scatter, weights, turned = [], [], []
    order = np.argsort(cluster, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(cluster[order])) + 1):
        gram = x[rows].T @ x[rows]
        values, vectors = np.linalg.eigh(gram)
        seen = values < 1.0 - 1e-6  # a direction that only this cluster shows has no error to look at
        grown = np.where(seen, 1.0 / np.sqrt(np.where(seen, 1.0 - values, 1.0)), 0.0)
        w = vectors @ (grown * (vectors.T @ c))
        scatter.append(float(w @ (x[rows].T @ rest[rows])))
        weights.append(float(w @ gram @ w))
        turned.append(gram @ w)
    between = np.diag(weights) - np.array(turned) @ np.array(turned).T
    trace = float(np.trace(between))
    freedom = trace**2 / max(float(np.sum(between**2)), 1e-300) if trace > 0.0 else 0.0
    n_sizes, last = own.shape[1], freedom - own.shape[1] + 1.0
    variance = float(np.sum(np.square(scatter)))
    if last <= 0.0 or trace <= 0.0:
        return 1.0
    ratio = strength * trace / max(variance, 1e-300) / n_sizes * last / freedom
    return float(fisher.sf(ratio, n_sizes, last))


def flip_basis(products: Array) -> Array:
    """Prepare sign flips: without an effect, either sign of the products of a motion is as likely.

    Args:
        products: Products of residual and change in each motion, (n_motions, n_sizes), without a unit.

    Returns:
        Orthonormal basis of their columns, (n_motions, rank). The squared length of signs in it is a
        statistic that no scale of the sizes changes; with as many sizes as motions, all signs have the same.
    """
    left, sizes, _ = np.linalg.svd(products, full_matrices=False)
    return np.asarray(left[:, sizes > 1e-8 * max(float(sizes[0]), 1e-300)]) if sizes.size else left


def flips_p(bases: Sequence[Sequence[Array]], seed: int) -> Array:
    """Return the probability of the products of each effect, or better ones of any, if none is present.

    The signs of all products of a motion are flipped together. Each draw is judged by its best trial of all
    effects, as the data are, so that the choice among trials and effects is part of the test.

    Args:
        bases: For each effect its trials, each as `flip_basis`, (n_motions, rank).
        seed: Seed of the signs.

    Returns:
        Probabilities, (n_effects,).
    """
    tables = [(k, table) for k, trials in enumerate(bases) for table in trials if table.shape[1]]
    found = np.ones(len(bases))
    if not tables:
        return found
    n = tables[0][1].shape[0]
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(DRAWS, n))
    largest: dict[int, Array] = {}
    seen = np.ones(len(bases))
    for k, table in tables:
        rank = table.shape[1]
        lengths = np.sum((signs @ table) ** 2, axis=1)
        largest[rank] = np.maximum(largest.get(rank, np.zeros(DRAWS)), lengths)
        seen[k] = min(seen[k], float(_tail(np.sum(table.sum(axis=0) ** 2), rank, n)))
    null = np.min([_tail(lengths, rank, n) for rank, lengths in largest.items()], axis=0)
    found = (np.sum(null[None, :] <= seen[:, None] * (1.0 + 1e-9), axis=1) + 1.0) / (DRAWS + 1.0)
    return np.where(seen < 1.0, found, 1.0)


def _tail(length: Array, rank: int, n: int) -> Array:
    """Return the probability of a longer projection of random signs, which makes ranks comparable."""
    if rank >= n:
        return np.ones_like(length)
    return np.asarray(betaincc(0.5 * rank, 0.5 * (n - rank), np.clip(length / n, 0.0, 1.0)))


def wald_by_place(p: Array, places: Sequence[str]) -> Array:
    """Return the probability of each Wald test, or a smaller one at any place, if no effect is present.

    At a place, the tests count together by Bonferroni; the places count by Holm (1979): the best place is
    held against chance at all of them, the next one at those that are left.

    Args:
        p: Probability of each effect, (n_effects,).
        places: Place of each effect.

    Returns:
        Probabilities, (n_effects,).
    """
    names = np.array(places)
    # an effect that cannot be tested with so few clusters cannot raise a false alarm either
    at = {name: max(1, int(np.sum((names == name) & (p < 1.0)))) for name in dict.fromkeys(places)}
    local = np.minimum(p * np.array([at[name] for name in places]), 1.0)
    best = {name: float(local[names == name].min()) for name in at}
    found, worst = np.ones(len(p)), 0.0
    for k, name in enumerate(sorted(best, key=lambda one: best[one])):
        mine = names == name
        found[mine] = np.maximum(np.minimum(local[mine] * (len(best) - k), 1.0), worst)
        worst = max(worst, min(best[name] * (len(best) - k), 1.0))
    return found


def can_flip(n_motions: int) -> bool:
    """Return whether sign flips can reject anything: the least probability is that of all signs alike.

    Args:
        n_motions: Number of motions.
    """
    return n_motions > 0 and 2.0 ** (1 - n_motions) <= 0.5 * FALSE_ALARM
