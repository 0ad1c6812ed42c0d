"""Family-wise detection limit of an effect in a case, from its noise and its number of motions.

The test: in motion m, the score of an effect is the product of its change d_m of the shown positions and the
residual r_m, both whitened. With amplitude a its mean is a I_m and its variance I_m, where I_m = d_m . d_m.
The scatter of the scores between M motions estimates the noise, so their sum over sqrt(sum I_m) has Student's
t-distribution with M - 1 degrees of freedom, and with the effect a noncentral one with noncentrality
a sqrt(sum I_m). With H hypotheses, a two-sided test at 0.05 / H each keeps false alarms of all together below
5 % (Bonferroni). The limit is the noncentrality at which the test has 90 % power.

The strength of an effect is sqrt(sum d_m . d_m) over the fitted motions, without the part that the nuisances
imitate: each of them is a column with a prior as wide as the number. An effect is at its limit when its
strength is that noncentrality. The strength is computed with the effect at its true size, and with the
nuisances where they imitate it, so that nothing is linearised. The first second of a motion does not count,
because its start depends on where friction held the joint.
"""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.stats import nct, t

from simgap.arrays import Array

FALSE_ALARM: Final = 0.05
POWER: Final = 0.9
QUANTUM_RAD: Final = 2.0 * np.pi / 4096
"""Step of a 12-bit encoder."""
NOISE_RAD: Final = 0.0015
"""Standard deviation of the noise before it is quantised: about one step, as the SO-101 shows after a fit."""
CORRELATION: Final = 0.8
"""Correlation of neighbouring samples, 10 ms apart: a time constant of 45 ms."""


@dataclass(frozen=True, slots=True)
class Noise:
    """First-order autoregression with the variance and the first covariance of noise and quantisation."""

    sd_rad: float
    correlation: float


def noise_with_quantisation() -> Noise:
    """Return the noise of the logs; quantisation adds a variance of quantum^2 / 12, white."""
    variance = NOISE_RAD**2 + QUANTUM_RAD**2 / 12.0
    return Noise(float(np.sqrt(variance)), CORRELATION * NOISE_RAD**2 / variance)


def whiten(change_rad: Array) -> Array:
    """Whiten changes of positions along their last axis, (..., n)."""
    noise = noise_with_quantisation()
    first = change_rad[..., :1] / noise.sd_rad
    later = change_rad[..., 1:] - noise.correlation * change_rad[..., :-1]
    later = later / (noise.sd_rad * np.sqrt(1.0 - noise.correlation**2))
    return np.concatenate([first, later], axis=-1)


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Columns of the nuisances, whitened, each for one standard deviation of its prior."""

    columns: Array
    """(n, n_nuisances)."""
    solve: Array
    """Inverse of columns' columns + 1, times columns', (n_nuisances, n)."""


def make_nuisance(columns: Array) -> Nuisance:
    """Prepare the removal of what nuisances imitate; columns are (n, n_nuisances)."""
    gram = columns.T @ columns + np.eye(columns.shape[1])
    return Nuisance(columns, np.asarray(np.linalg.solve(gram, columns.T), float))


def information(one: Array, other: Array, nuisance: Nuisance) -> float:
    """Return the product of two whitened changes, (n,), less what the nuisances imitate."""
    return float(one @ other - (one @ nuisance.columns) @ (nuisance.solve @ other))


@cache
def limit_noncentrality(motions: int, hypotheses: int) -> float:
    """Return the strength of an effect at the family-wise limit."""
    freedom = motions - 1
    threshold = float(t.isf(FALSE_ALARM / (2.0 * hypotheses), freedom))
    return float(brentq(lambda shift: nct.sf(threshold, freedom, shift) - POWER, 0.0, 10.0 * threshold))
