"""Effects fitted with the simulator in the loop: half of them are no straight lines at the size they have.

Gauss-Newton on the whitened residual w(y - (f(x) - f(0))) - N v over all parameters x of the effects (those
that only shape them, too) within their bounds, nuisances v refitted in every step with their prior.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import lsq_linear

from fsw.kinematics.transforms import Array
from ground.gap.hypothesis import Hypothesis, Parameter
from ground.gap.layout import Evidence
from ground.gap.prepared import Prepared
from ground.gap.simulator import Simulator

PASSES: Final = 6
STEP: Final = 0.02
"""Share of a typical size over which the simulator is differentiated."""
SETTLED: Final = 0.01
"""A pass that moves everything by less than this share of its sigma is the last."""
HALVINGS: Final = 4
SHAPE_SIGMA: Final = 1.0
"""Of parameters that only shape: about their typical value, as a share of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The most probable values of some effects."""

    hypotheses: tuple[Hypothesis, ...]
    values: tuple[Array, ...]
    """Of all parameters of each, in their units."""
    sigma: tuple[Array, ...]
    """One sigma of each, nuisances free."""
    at_bound: tuple[tuple[str, ...], ...]
    """Names of those that are at a bound: no finding."""
    deviance: float
    """With prior and nuisances, from that of no effect: below 0 if it explains anything."""
    change: Array
    """What the effects change in the features, f(x) - f(0), (m,)."""
    slopes: tuple[Array, ...]
    """Derivatives of the features by each parameter times its typical size, (m, k) of each."""


def refine(
    simulator: Simulator,
    prepared: Prepared,
    evidence: Evidence,
    nominal: Array,
    start: Mapping[Hypothesis, Array],
) -> Refined:
    """From starting values of all parameters of each effect; `nominal` is what is predicted without, (m,)."""
    who = tuple(start)
    parameters = tuple(parameter for hypothesis in who for parameter in hypothesis.parameters)
    unit = np.array([abs(parameter.typical) for parameter in parameters])
    ends = np.array([[p.least for p in parameters], [p.most for p in parameters]])
    x = np.clip(np.concatenate([start[hypothesis] for hypothesis in who]), *ends)
    fit = _Fit(simulator, prepared, prepared.whiten(evidence.value), nominal, who, parameters)
    cost, slopes = fit.cost(x), fit.slopes(x, unit, ends)
    covariance = fit.covariance(slopes)
    for _ in range(PASSES):
        step = fit.step(x, slopes, (ends - x) / unit)
        better = next(
            (s for s in step * 0.5 ** np.arange(HALVINGS)[:, None] if fit.cost(x + unit * s) < cost), None
        )
        if better is None:
            break
        x = np.clip(x + unit * better, *ends)
        cost, slopes = fit.cost(x), fit.slopes(x, unit, ends)
        covariance = fit.covariance(slopes)
        if np.all(np.abs(better) < SETTLED * np.sqrt(np.diag(covariance))):
            break
    sigma = unit * np.sqrt(np.diag(covariance))
    cut = np.cumsum([len(hypothesis.parameters) for hypothesis in who])[:-1]
    ended = [
        p.name if at and p.sizes else "" for p, at in zip(parameters, np.any(x == ends, axis=0), strict=True)
    ]
    names = tuple(tuple(n for n in part if n) for part in np.split(np.array(ended, dtype=object), cut))
    return Refined(
        who, tuple(np.split(x, cut)), tuple(np.split(sigma, cut)), names,
        cost - fit.cost(np.array([p.absent for p in parameters])), fit.change(x),
        tuple(np.split(slopes, cut, axis=1)),
    )  # fmt: skip


def columns_at(refined: Refined) -> Array:
    """One effect as columns about its estimate, (m, k): the whole change, then what else it may do.

    The whole change is what it is at the estimate, so that a straight line through none and the estimate is
    in the span, and so are all small departures from the estimate.
    """
    slopes = refined.slopes[0]
    values = np.array([
        (v - p.absent) / p.typical if p.sizes else 0.0
        for v, p in zip(refined.values[0], refined.hypotheses[0].parameters, strict=True)
    ])  # fmt: skip
    largest = int(np.argmax(np.abs(values)))
    others = [i for i, p in enumerate(refined.hypotheses[0].parameters) if i != largest and p.sizes]
    return np.column_stack([refined.change, *(slopes[:, i] for i in others)])


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A cost and its derivatives."""

    simulator: Simulator
    prepared: Prepared
    y: Array
    nominal: Array
    who: tuple[Hypothesis, ...]
    parameters: tuple[Parameter, ...]

    def change(self, x: Array) -> Array:
        """f(x) - f(0), (m,)."""
        cut = np.cumsum([len(hypothesis.parameters) for hypothesis in self.who])[:-1]
        settings = dict(zip(self.who, np.split(x, cut), strict=True))
        predicted = self.simulator.predict(settings, np.zeros(len(self.simulator.nuisances)))
        return np.asarray(predicted - self.nominal)

    def cost(self, x: Array) -> float:
        """Deviance with nuisances free, and the prior of what only shapes."""
        rest = self.y - self.prepared.whiten(self.change(x))
        along = self._N.T @ rest
        return float(rest @ rest - along @ self.prepared.C[-1] @ along + np.sum(self._shape(x) ** 2))

    def slopes(self, x: Array, unit: Array, ends: Array) -> Array:
        """Centred differences, one-sided at a bound, per typical size, (m, n)."""
        result = []
        for index in range(x.size):
            high, low = x.copy(), x.copy()
            high[index] = min(x[index] + STEP * unit[index], ends[1, index])
            low[index] = max(x[index] - STEP * unit[index], ends[0, index])
            result.append((self.change(high) - self.change(low)) * (unit[index] / (high[index] - low[index])))
        return np.column_stack(result)

    def covariance(self, slopes: Array) -> Array:
        """Of the parameters per typical size, nuisances free."""
        information, _ = self._normal(slopes, np.zeros(self.y.size))
        return np.asarray(np.linalg.pinv(information, rcond=1e-12, hermitian=True))

    def step(self, x: Array, slopes: Array, room: Array) -> Array:
        """The best step within the bounds, per typical size."""
        information, gradient = self._normal(slopes, self.y - self.prepared.whiten(self.change(x)))
        gradient = gradient - self._shape(x) / SHAPE_SIGMA
        L = np.linalg.cholesky(information + 1e-12 * np.trace(information) * np.eye(x.size))
        room = np.stack([np.minimum(room[0], -1e-12), np.maximum(room[1], 1e-12)])
        return np.asarray(lsq_linear(L.T, np.linalg.solve(L, gradient), room).x)

    @property
    def _N(self) -> Array:
        return self.prepared.A[:, : self.prepared.q]

    def _normal(self, slopes: Array, rest: Array) -> tuple[Array, Array]:
        """Information and gradient with nuisances free; what only shapes has its prior."""
        S = self.prepared.whiten(slopes)
        across = S.T @ self._N
        only = np.array([not parameter.sizes for parameter in self.parameters]) / SHAPE_SIGMA**2
        information = S.T @ S - across @ self.prepared.C[-1] @ across.T + np.diag(only)
        return information, S.T @ rest - across @ (self.prepared.C[-1] @ (self._N.T @ rest))

    def _shape(self, x: Array) -> Array:
        """Departure of what only shapes from typical, in sigmas."""
        return np.array([
            0.0 if p.sizes else (v - p.typical) / abs(p.typical) / SHAPE_SIGMA
            for v, p in zip(x, self.parameters, strict=True)
        ])  # fmt: skip
