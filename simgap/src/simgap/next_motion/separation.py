"""Choose the motion that tells rivals apart best; all that both products share of it.

A rival is a model that could be the cause. If rival i is the cause, rival j with its sizes fitted again comes
as near as (T-optimality, Atkinson and Fedorov 1975, Biometrika 62:57)

    T_ij = min over delta of |f_i - f_j - J_j delta|^2 + delta' H_j delta = d' (1 + J_j C_j J_j')^-1 d

with d = f_i - f_j, the predictions f and their derivatives J in units of the noise, and the covariance
C = 1 / H that earlier motions leave. A log likelihood ratio then has the mean T / 2 and the variance T: a
test with a false alarm of 5 % excludes the wrong one with the probability Phi(sqrt T - 1.645).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from scipy.stats import norm

from simgap.arrays import Array
from simgap.selection.chance import FALSE_ALARM
from simgap.selection.fit import STEP

LEAST_POWER: Final = 0.5
"""Probability from which on a motion tells two rivals apart: more often than not."""
AT_ONCE: Final = 8
"""Motions whose derivatives are simulated together."""

Slopes = Sequence[Array]
"""For each rival, the change of its prediction by what was fitted with it, each for one standard deviation of
independent errors, (n, n_sizes), in units of the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Motions that were compared to the end, the best first."""

    motions: tuple[int, ...]
    sigmas: Array
    """Root of T of each pair, the smaller of both orders, (n_motions, n_pairs)."""
    pairs: tuple[tuple[int, int], ...]

    @property
    def powers(self) -> Array:
        """Probability that a motion excludes the wrong one of each pair, (n_motions, n_pairs)."""
        return np.asarray(norm.sf(norm.isf(FALSE_ALARM) - self.sigmas))

    @property
    def tells_apart(self) -> bool:
        """Return whether the best motion tells any pair apart."""
        return bool(np.any(self.powers[:1] >= LEAST_POWER))


def choose_motion(
    predictions: Sequence[Array],
    differentiate: Callable[[Sequence[int]], Sequence[Slopes]],
    chances: Sequence[float],
) -> Choice:
    """Choose the motion that leaves the fewest pairs of rivals confused, by their chances.

    Earlier motions tell what they exclude apart already: it has a small weight beside what is in doubt.

    What sizes can imitate only lessens a difference, so the plain one is a bound. Derivatives are simulated
    while a bound is better than the best motion: the result is that of all motions.

    Args:
        predictions: What the rivals predict for each motion, (n_rivals, n) each, in units of the noise; n may
            differ from motion to motion. NaN where a rival cannot make the motion, which is left out.
        differentiate: Returns the slopes of some motions.
        chances: Probability of each rival, (n_rivals,).
    """
    pairs = tuple(combinations(range(len(predictions[0])), 2))
    weights = np.array([max(chances[i] * chances[j], 1e-12) for i, j in pairs])
    bounds = np.array([[np.linalg.norm(one[i] - one[j]) for i, j in pairs] for one in predictions])
    hopes = np.where(np.isfinite(bounds).all(axis=1), count_confused(np.nan_to_num(bounds), weights), np.inf)
    order = [int(m) for m in np.argsort(hopes, kind="stable") if np.isfinite(hopes[m])]
    done: list[tuple[float, int, Array]] = []
    while order and (not done or hopes[order[0]] < min(done)[0]):
        part, order = order[:AT_ONCE], order[AT_ONCE:]
        for m, slopes in zip(part, differentiate(part), strict=True):
            sigma = np.array([find_sigma(predictions[m], slopes, *pair) for pair in pairs])
            done.append((float(count_confused(sigma, weights)), m, sigma))
    done.sort(key=lambda one: one[:2])
    sigmas = np.array([sigma for *_, sigma in done]).reshape(-1, len(pairs))
    return Choice(tuple(m for _, m, _ in done), sigmas, pairs)


def count_confused(sigmas: Array, weights: Array) -> Array:
    """Return the share of pairs that stay confused on average, (...), at separations (..., n_pairs)."""
    return np.asarray(np.average(norm.sf(sigmas - norm.isf(FALSE_ALARM)), axis=-1, weights=weights))


def find_sigma(values: Array, slopes: Slopes, i: int, j: int) -> float:
    """Return the separation of two rivals, whichever is the cause, in standard deviations.

    Derivatives are known to about STEP: as much of what sizes imitate counts as an error of them.

    Args:
        values: Predictions of all rivals, (n_rivals, n), in units of the noise.
    """
    d, least = values[i] - values[j], np.inf
    for own in (slopes[i], slopes[j]):
        along = own.T @ d
        # second differences may be parallel to first ones, and larger by many orders
        delta, *_ = np.linalg.lstsq(own.T @ own + np.eye(own.shape[1]), along)
        error = STEP * np.linalg.norm(own @ delta)
        least = min(least, float(d @ d - along @ delta - error**2))
    return float(np.sqrt(max(least, 0.0)))


def find_deviations(old: Array, prior: Array) -> Array:
    """Return independent changes of the sizes, each by one standard deviation, (n_sizes, n_sizes).

    Args:
        old: Derivatives in the earlier motions, (n_old, n_sizes), in units of the noise.
        prior: Standard deviations before these, (n_sizes,); infinite without a prior.
    """
    information = old.T @ old + np.diag(1.0 / prior**2)
    values, vectors = np.linalg.eigh(information)
    # what nothing tells is free: its error is as large as numbers allow
    values = np.maximum(values, 1e-12 * max(float(values[-1]), 1e-300))
    return np.asarray(vectors / np.sqrt(values))
