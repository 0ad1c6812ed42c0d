"""Chance: the probability of an effect if it is absent, also with few motions."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.stats import f as fisher

from diagnosis.arrays import Array, Integers

FALSE_ALARM: Final = 0.05
"""Largest probability of a name anywhere if no effect is present."""


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


def count_distinct(directions: Sequence[Array]) -> float:
    """Count how many independent tests as many false alarms would raise as tests of these directions.

    Tests of effects that look alike, such as a payload and a heavier link, are right or wrong together. The
    count is that of Li and Ji (2005), from the eigenvalues of the correlations.

    Args:
        directions: Change of the residuals by each effect, (n_rows,) each, in any unit.

    Returns:
        Number from 1 to that of the directions which are not 0; 0 if there is none.
    """
    lengths = [float(np.linalg.norm(one)) for one in directions]
    unit = [one / length for one, length in zip(directions, lengths, strict=True) if length > 0.0]
    if not unit:
        return 0.0
    table = np.array(unit)
    values = np.round(np.clip(np.linalg.eigvalsh(table @ table.T), 0.0, None), 9)
    return float(np.sum((values >= 1.0) + values - np.floor(values)))
