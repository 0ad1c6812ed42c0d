"""What others would do with the same features: to be shown in the same table."""

from typing import Final

import numpy as np
from mujoco.minimize import Verbosity, least_squares
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from fsw.kinematics.transforms import Array
from ground.diagnosis.case import Case
from ground.diagnosis.fits import RIDGE
from ground.diagnosis.layout import Layout
from ground.diagnosis.prepared import Prepared

FEATURES: Final = 400
"""Of a channel, at most, that a Gaussian process is fitted to: evenly thinned."""
HUGE: Final = 1e6
"""Standard errors: beyond any bound that matters."""
LENGTHS: Final = (0.1, 100.0)
"""Of a kernel, in standard deviations of the conditions."""


def largest_error(layout: Layout, residual: Array) -> str:
    """The place whose residual (m,), over its floor, has the largest mean square: taken for the cause."""
    count = np.bincount(layout.place, minlength=len(layout.places))
    square = np.bincount(layout.place, residual**2, minlength=len(layout.places))
    return layout.places[int(np.argmax(square / np.maximum(count, 1)))]


def everything_free(prepared: Prepared, case: Case) -> tuple[int, Array]:
    """All hypotheses fitted at once within their bounds: the one that explains most, and all sizes (K,).

    By the least squares that mujoco.sysid fits with, in straight lines. Typical sizes are 1. What one
    explains is measured as t'R t of its own columns.
    """
    columns = np.flatnonzero(prepared.scale > 0.0)
    R = prepared.R[-1][np.ix_(columns, columns)]
    t = np.zeros(prepared.owner.size)
    L = np.linalg.cholesky(R + RIDGE * np.eye(columns.size))
    wanted = np.linalg.solve(L, case.all[columns])[:, None]
    bounds = [np.clip(end, -HUGE, HUGE)[:, None] for end in prepared.bounds[:, columns]]
    x, _ = least_squares(
        np.zeros((columns.size, 1)),
        lambda x: L.T @ x - wanted,
        bounds,
        jacobian=lambda _x, _r: L.T,
        verbose=Verbosity.SILENT,
    )
    t[columns] = x[:, 0]
    own = [
        t[at] @ prepared.R[-1][np.ix_(at, at)] @ t[at]
        for at in (np.flatnonzero(prepared.owner == h) for h in range(len(prepared.hypotheses)))
    ]
    by = np.where(prepared.scale > 0.0, 1.0 / np.where(prepared.scale > 0.0, prepared.scale, 1.0), 0.0)
    return int(np.argmax(own)), t * by


def gaussian_process(layout: Layout, residual: Array, held_out: Layout) -> Array:
    """What a Gaussian process per channel, over the conditions, predicts of held-out residuals, (m_held,).

    Residuals are in units of their floor, so that the noise is 1. The kernel is s^2 exp(-|x - x'|^2 / 2 l^2)
    of the standardised conditions; s and l make the marginal likelihood largest. It names nothing.
    """
    result = np.zeros(held_out.size)
    for number, channel in enumerate(held_out.channels):
        if channel not in layout.channels:
            continue
        rows = np.flatnonzero(layout.channel == layout.channels.index(channel))
        there = held_out.channel == number
        if not rows.size or not there.any():
            continue
        rows = rows[:: -(-rows.size // FEATURES)]
        middle, spread = layout.condition[rows].mean(axis=0), layout.condition[rows].std(axis=0)
        spread = np.where(spread > 0.0, spread, 1.0)
        x, new = ((of - middle) / spread for of in (layout.condition[rows], held_out.condition[there]))
        result[there] = _predicted(x, residual[rows], new)
    return result


def _predicted(x: Array, y: Array, new: Array) -> Array:
    """Of one channel, in the most likely kernel."""
    square, across = _squares(x, x), _squares(new, x)

    def cost(log: Array) -> float:
        K = np.exp(2.0 * log[0] - square / (2.0 * np.exp(2.0 * log[1]))) + np.eye(y.size)
        factor = cho_factor(K, lower=True)
        return float(0.5 * y @ cho_solve(factor, y) + np.log(np.diag(factor[0])).sum())

    limits = ((np.log(1e-3), np.log(1e3)), tuple(np.log(LENGTHS)))
    log = minimize(cost, np.zeros(2), bounds=limits, options={"maxiter": 30}).x
    K = np.exp(2.0 * log[0] - square / (2.0 * np.exp(2.0 * log[1]))) + np.eye(y.size)
    weights = cho_solve(cho_factor(K, lower=True), y)
    return np.asarray(np.exp(2.0 * log[0] - across / (2.0 * np.exp(2.0 * log[1]))) @ weights)


def _squares(a: Array, b: Array) -> Array:
    """Squared distances, (n, m)."""
    return np.asarray(np.sum((a[:, None, :] - b[None, :, :]) ** 2, axis=-1))
