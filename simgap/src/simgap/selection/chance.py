"""Chance: the probability of an effect if it is absent, also with few motions.

Residuals and changes are arrays (n_rows,) without a unit, orthogonal to the changes by the base parameters:
`change` is that by the fitted sizes, `n_sizes` of them; `before` and `after` are residuals without and with
the effect. `cluster` is the cluster of each row, an index from 0.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2
from scipy.stats import f as fisher

from simgap.arrays import Array, Integers

FALSE_ALARM: Final = 0.05
"""Largest probability of a name anywhere if no effect is present."""
ASYMPTOTIC_FROM: Final = 300.0
"""Half a chi-square above which its tail is computed by the leading term."""
DRAWS: Final = 2000
"""Draws of a probability: one of 5 % is then right to half a percent."""


def wald_p(basis: Array, change: Array, residual: Array, cluster: Integers, n_sizes: int) -> float:
    """Test whether the change that an effect makes is due to noise; return the p-value.

    The errors are CR2 (Bell and McCaffrey 2002): those of a cluster are enlarged by as much as the fit has
    followed it. The degrees of freedom fall where few clusters decide. The change is that of the best sizes:
    Hotelling's distribution allows for their choice. The columns of `basis`, (n_rows, n_base), are
    orthonormal changes by the base parameters.
    """
    length = float(np.linalg.norm(change))
    if length == 0.0:
        return 1.0
    own = change / length
    product = float(own @ residual)
    strength = product**2
    x = np.column_stack([basis, own])
    c = np.append(np.zeros(basis.shape[1]), 1.0)
    rest = residual - own * product
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
    last = freedom - n_sizes + 1.0
    variance = float(np.sum(np.square(scatter)))
    if last <= 0.0 or trace <= 0.0:
        return 1.0
    ratio = strength * trace / max(variance, 1e-300) / n_sizes * last / freedom
    return float(fisher.sf(ratio, n_sizes, last))


def stationary_p(n_base: int, change: Array, residual: Array, cluster: Integers, n_sizes: int) -> float:
    """Test as `wald_p` where the noise is known to be the same at all times, as motions that repeat show.

    All residuals then tell the noise, also of an effect that acts in few samples. Its correlation counts by
    the sums over clusters. The residuals have followed `n_base` base parameters.
    """
    length = float(np.linalg.norm(change))
    sums = np.bincount(cluster)
    freedom = len(sums) - n_base - n_sizes
    if length == 0.0 or freedom <= 0:
        return 1.0
    own = change / length
    product = float(own @ residual)
    sums = np.bincount(cluster, weights=residual - own * product)
    variance = float(sums @ sums) / len(residual) * len(sums) / freedom
    return float(fisher.sf(product**2 / max(variance, 1e-300) / n_sizes, n_sizes, freedom))


def chi_square_log_p(statistic: float, freedom: float) -> float:
    """Return the natural logarithm of the tail probability of a chi-square.

    Far in the tail the probability underflows; there the leading term of the incomplete gamma function is
    used, so that the order of strong effects is kept.
    """
    x, half = max(statistic, 0.0) / 2.0, freedom / 2.0
    if x <= ASYMPTOTIC_FROM:
        return float(chi2.logsf(2.0 * x, freedom))
    return float((half - 1.0) * np.log(x) - x - gammaln(half))


def known_noise_log_p(before: Array, after: Array, n_sizes: int) -> float:
    """Return the log p of an effect's decrease of the sum of squares in known noise (Wilks 1938)."""
    return chi_square_log_p(float(before @ before - after @ after), n_sizes)


def count_distinct(directions: Sequence[Array]) -> float:
    """Count how many independent tests as many false alarms would raise as tests of these directions.

    Tests of effects that look alike, such as a payload and a heavier link, are right or wrong together. The
    count is that of Li and Ji (2005), from the eigenvalues of the correlations. It is from 1 to the number of
    directions that are not 0; 0 if there is none.
    """
    lengths = [float(np.linalg.norm(one)) for one in directions]
    unit = [one / length for one, length in zip(directions, lengths, strict=True) if length > 0.0]
    if not unit:
        return 0.0
    table = np.array(unit)
    values = np.round(np.clip(np.linalg.eigvalsh(table @ table.T), 0.0, None), 9)
    return float(np.sum((values >= 1.0) + values - np.floor(values)))


def alternative_p(
    other: tuple[Array, Array],
    rivals: Sequence[tuple[Array, Array]],
    cluster: Integers,
    seed: int,
    noise_std: float = 0.0,
) -> float:
    """Test whether a model may be right although another fits better (Cox 1961); return the p-value.

    Data are drawn from the model: its prediction with its residuals, whose sign changes at random from
    cluster to cluster. All models are refitted to them, along their derivatives. The better model is the best
    of several, so the advantage of the best one counts in each draw.

    A model has residuals, (n_rows,), and an orthonormal basis of the changes by its sizes, (n_rows, n_sizes).
    Rivals are all models that might have been found, the better one first, with the same weights. A known
    `noise_std`, in the same unit, is drawn instead of the signs.
    """
    theirs, their_basis = other
    if noise_std:
        return _known_noise_alternative_p(other, rivals, seed, noise_std)
    n_clusters = int(cluster.max(initial=0)) + 1
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (DRAWS, n_clusters))
    signs[0] = 1.0  # the data themselves

    def draw(directions: Array) -> Array:
        """Return the products of directions, (n_rows, n), with the drawn residuals, (DRAWS, n)."""
        table = theirs[:, None] * directions
        sums = np.array([np.bincount(cluster, column, n_clusters) for column in table.T])
        return np.asarray(signs @ sums.T)

    to_them = np.sum(draw(their_basis) ** 2, axis=1)
    advantages = []
    for mine, my_basis in rivals:
        apart = mine - theirs
        drawn = draw(np.column_stack([my_basis, apart]))
        to_me = np.sum((my_basis.T @ apart + drawn[:, :-1]) ** 2, axis=1)
        advantages.append(to_me - to_them - apart @ apart - 2.0 * drawn[:, -1])
    rounding = 1e-9 * float(theirs @ theirs)
    return float(np.mean(np.max(advantages, axis=0) >= advantages[0][0] - rounding))


def _known_noise_alternative_p(
    other: tuple[Array, Array], rivals: Sequence[tuple[Array, Array]], seed: int, noise_std: float
) -> float:
    """Test as `alternative_p` with drawn noise: only its products with the directions of the models count."""
    theirs, their_basis = other
    parts = [their_basis]
    for mine, my_basis in rivals:
        parts += [my_basis, (mine - theirs)[:, None]]
    triangle = np.linalg.qr(np.column_stack(parts), mode="r")
    drawn = noise_std * np.random.default_rng(seed).standard_normal((DRAWS, len(triangle))) @ triangle
    products = np.split(drawn, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1)
    to_them = np.sum(products[0] ** 2, axis=1)
    advantages = []
    for k, (mine, my_basis) in enumerate(rivals):
        apart = mine - theirs
        to_me = np.sum((my_basis.T @ apart + products[1 + 2 * k]) ** 2, axis=1)
        advantages.append(to_me - to_them - apart @ apart - 2.0 * products[2 + 2 * k][:, 0])
    best = rivals[0][0]
    return float(np.mean(np.max(advantages, axis=0) >= theirs @ theirs - best @ best))
