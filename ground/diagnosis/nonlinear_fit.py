"""Nonlinear fit of effects: about half of them are not linear at their estimated size.

Gauss-Newton minimises |w(y - f(x)) - N v|^2 plus the priors. Here w whitens, f(x) is the change by the
effects, and x holds all their parameters, shape parameters too, within bounds. The nuisances v are refitted
in every step with their prior. f is the quadratic surrogate or the simulator (`EffectResponse`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from scipy.optimize import lsq_linear

from fsw.kinematics.transforms import Array
from ground.diagnosis.normal_equations import NormalEquations, residual_deviance
from ground.diagnosis.problem import Hypothesis, Ints, Parameter, Simulator
from ground.diagnosis.sensitivity import Sensitivities

MAX_STEPS: Final = 5
SHAPE_STEP: Final = 0.1
"""Finite-difference step of a shape parameter, as a share of its typical size."""
CONVERGED_SIGMAS: Final = 1.0
"""The iteration stops when a step moves every parameter by less than this many sigmas."""
MAX_HALVINGS: Final = 2
BOUND_TOLERANCE: Final = 1e-6
"""Distance from a bound, as a share of a typical size, at which a parameter counts as at the bound."""
SHAPE_PRIOR_SIGMA: Final = 1.0
"""Prior sigma of shape parameters about their typical value, as a share of it."""
INFORMATIVE_SHARE: Final = 0.5
"""Share of the prior sigma below which the data determine a shape parameter."""


@dataclass(frozen=True, slots=True, eq=False)
class QuadraticSurrogate:
    """Quadratic approximation of the simulator; linear beyond the simulated departures."""

    sensitivities: Sensitivities

    def change(self, settings: Mapping[Hypothesis, Array]) -> Array:
        """Compute the change of the features.

        Args:
            settings: Values of all parameters of each effect in their units, shape (p,). Shape parameters
                have no influence.

        Returns:
            Change in the units of the channels, shape (m,).
        """
        total = np.zeros(self.sensitivities.layout.size)
        for hypothesis, values in settings.items():
            columns, a = self._departures(hypothesis, values)
            inside = self._within_reach(columns, a)
            total += self.sensitivities.effect[:, columns] @ a
            total += self.sensitivities.curve[:, columns] @ (inside * (2.0 * a - inside))
        return total

    def slopes(self, settings: Mapping[Hypothesis, Array], change: Array) -> Array:
        """Compute the derivatives by each parameter of each effect, per typical size.

        Args:
            settings: Values of all parameters of each effect in their units, shape (p,); n in total.
            change: Not used; change at these values in the units of the channels, shape (m,).

        Returns:
            Derivatives in the units of the channels, shape (m, n); 0 for shape parameters.
        """
        parts = []
        for hypothesis, values in settings.items():
            columns, a = self._departures(hypothesis, values)
            own = self.sensitivities.effect[:, columns]
            own = own + 2.0 * self.sensitivities.curve[:, columns] * self._within_reach(columns, a)
            part = np.zeros((self.sensitivities.layout.size, len(hypothesis.parameters)))
            part[:, [parameter.is_amplitude for parameter in hypothesis.parameters]] = own
            parts.append(part)
        return np.hstack(parts)

    def _within_reach(self, columns: Ints, a: Array) -> Array:
        """Clip amplitudes to the simulated departures."""
        reach = self.sensitivities.reach[columns]
        return np.clip(a, -reach, reach)

    def _departures(self, hypothesis: Hypothesis, values: Array) -> tuple[Ints, Array]:
        """Return the columns of a hypothesis, and its amplitudes in typical sizes."""
        columns = np.flatnonzero(self.sensitivities.owner == self.sensitivities.hypotheses.index(hypothesis))
        return columns, hypothesis.departures(values)


class EffectResponse(Protocol):
    """Response of the features to effects."""

    def change(self, settings: Mapping[Hypothesis, Array]) -> Array:
        """Compute the change of the features.

        Args:
            settings: Values of all parameters of each effect in their units, shape (p,).

        Returns:
            Change in the units of the channels, shape (m,).
        """

    def slopes(self, settings: Mapping[Hypothesis, Array], change: Array) -> Array:
        """Compute the derivatives by each parameter of each effect, per typical size.

        Args:
            settings: Values of all parameters of each effect in their units, shape (p,); n in total.
            change: Change at these values in the units of the channels, shape (m,).

        Returns:
            Derivatives in the units of the channels, shape (m, n).
        """


@dataclass(frozen=True, slots=True, eq=False)
class SimulatorResponse:
    """Response by simulation; slopes of amplitudes come from the surrogate, which suffices to start."""

    simulator: Simulator
    surrogate: QuadraticSurrogate

    def change(self, settings: Mapping[Hypothesis, Array]) -> Array:
        """Simulate the change of the features, with nominal nuisances.

        Args:
            settings: Values of all parameters of each effect in their units, shape (p,).

        Returns:
            Change in the units of the channels, shape (m,).
        """
        zero = np.zeros(len(self.simulator.nuisances))
        return np.asarray(self.simulator.predict(settings, zero) - self.simulator.predict({}, zero))

    def slopes(self, settings: Mapping[Hypothesis, Array], change: Array) -> Array:
        """Compute the derivatives; simulate once more for each shape parameter.

        Args:
            settings: Values of all parameters of each effect in their units, shape (p,); n in total.
            change: Change at these values in the units of the channels, shape (m,).

        Returns:
            Derivatives in the units of the channels, per typical size, shape (m, n).
        """
        result, column = self.surrogate.slopes(settings, change), 0
        for hypothesis in settings:
            for at, parameter in enumerate(hypothesis.parameters):
                if not parameter.is_amplitude:
                    result[:, column] = self._shape_slopes(settings, change, hypothesis, at)
                column += 1
        return result

    def _shape_slopes(
        self, settings: Mapping[Hypothesis, Array], change: Array, hypothesis: Hypothesis, at: int
    ) -> Array:
        parameter, values = hypothesis.parameters[at], settings[hypothesis]
        by, shifted = SHAPE_STEP * parameter.unit_size, values.copy()
        shifted[at] += by if values[at] + by <= parameter.most else -by
        difference = self.change({**settings, hypothesis: shifted}) - change
        return np.asarray(
            difference
            * parameter.unit_size
            * (-1.0 if parameter.typical < 0.0 else 1.0)
            / (shifted[at] - values[at])
        )


@dataclass(frozen=True, slots=True, eq=False)
class NonlinearFit:
    """Most probable values of some effects."""

    hypotheses: tuple[Hypothesis, ...]
    values: tuple[Array, ...]
    """Values of all parameters of each effect, in their units, each of shape (p,)."""
    sigma: tuple[Array, ...]
    """Standard deviations with nuisances free; NaN for a shape parameter that the data do not determine."""
    at_bound: tuple[tuple[str, ...], ...]
    """Names of the amplitude parameters of each effect that are at a bound; then it is not accepted."""
    change: Array
    """Change of the features by all effects, shape (m,)."""
    slopes: tuple[Array, ...]
    """Derivatives of the features by each parameter per typical size, of each effect, shape (m, p)."""
    cost: float
    """Remaining deviance, including the prior of the shape parameters."""

    def in_order(self, order: Sequence[int]) -> "NonlinearFit":
        """Return the same fit with the effects in another order, given by index."""
        return NonlinearFit(
            tuple(self.hypotheses[one] for one in order),
            tuple(self.values[one] for one in order),
            tuple(self.sigma[one] for one in order),
            tuple(self.at_bound[one] for one in order),
            self.change,
            tuple(self.slopes[one] for one in order),
            self.cost,
        )


def fit_nonlinear(
    response: EffectResponse, equations: NormalEquations, whitened: Array, start: Mapping[Hypothesis, Array]
) -> NonlinearFit:
    """Fit effects to a case by Gauss-Newton with Broyden updates, within bounds.

    Args:
        response: Response of the features to the effects.
        equations: Normal equations of the campaign; only their nuisances are used.
        whitened: Whitened features, shape (m,).
        start: Initial values of all p parameters of each effect in their units, shape (p,).

    Returns:
        Fit, effects in the order of `start`.
    """
    hypotheses = tuple(start)
    parameters = tuple(parameter for hypothesis in hypotheses for parameter in hypothesis.parameters)
    unit = np.array([parameter.unit_size for parameter in parameters])
    ends = np.array([[p.least for p in parameters], [p.most for p in parameters]])
    fit = _GaussNewton(response, equations, whitened, hypotheses, parameters)
    x = np.clip(np.concatenate([start[hypothesis] for hypothesis in hypotheses]), *ends)
    current = fit.evaluate(x)
    for _ in range(MAX_STEPS):
        step = fit.step(current, (ends - x) / unit)
        if np.all(np.abs(step) < CONVERGED_SIGMAS * fit.sigma(current)):
            current = fit.linear_step(current, np.clip(x + unit * step, *ends))
            x = current.x
            break
        tries = (
            fit.broyden_step(current, np.clip(x + unit * s, *ends))
            for s in step * 0.5 ** np.arange(MAX_HALVINGS)[:, None]
        )
        better = next((one for one in tries if one.cost < current.cost), None)
        if better is None:
            break
        current, x = better, better.x
    reached = np.any(np.abs(x - ends) <= BOUND_TOLERANCE * unit, axis=0)
    ended = [p.name if at and p.is_amplitude else "" for p, at in zip(parameters, reached, strict=True)]
    names = tuple(
        tuple(n for n in part if n) for part in np.split(np.array(ended, dtype=object), fit.offsets)
    )
    return NonlinearFit(
        hypotheses,
        tuple(np.split(x, fit.offsets)),
        tuple(np.split(unit * fit.reported_sigma(current), fit.offsets)),
        names,
        current.change,
        tuple(np.split(current.slopes, fit.offsets, axis=1)),
        current.cost,
    )


def linearise_at(hypothesis: Hypothesis, values: Array, change: Array, slopes: Array) -> Array:
    """Linearise an effect at its estimate.

    The first column is the whole change at the estimate. So the span contains both the line from no effect to
    the estimate, and small departures from the estimate.

    Args:
        hypothesis: Effect with n amplitude parameters.
        values: Estimated values of all p parameters in their units, shape (p,).
        change: Change of the features at the estimate, in the units of the channels, shape (m,).
        slopes: Derivatives by each parameter per typical size, in these units, shape (m, p).

    Returns:
        Columns, shape (m, n): the whole change, then the slopes of all amplitudes but the largest.
    """
    sized = [i for i, parameter in enumerate(hypothesis.parameters) if parameter.is_amplitude]
    largest = int(np.argmax(np.abs(hypothesis.departures(values))))
    others = [i for k, i in enumerate(sized) if k != largest]
    return np.column_stack([change, *(slopes[:, i] for i in others)])


@dataclass(frozen=True, slots=True, eq=False)
class _Iterate:
    """Parameters of one iteration, with response and cost."""

    x: Array
    change: Array
    slopes: Array
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class _GaussNewton:
    """Cost and derivatives; slopes refer to positive typical sizes."""

    response: EffectResponse
    equations: NormalEquations
    y: Array
    hypotheses: tuple[Hypothesis, ...]
    parameters: tuple[Parameter, ...]

    def evaluate(self, x: Array) -> _Iterate:
        """Evaluate response, slopes and cost at the start."""
        settings = self._settings(x)
        change = self.response.change(settings)
        slopes = self.response.slopes(settings, change)
        signs = np.array([-1.0 if parameter.typical < 0.0 else 1.0 for parameter in self.parameters])
        return _Iterate(x, change, slopes * signs, self._cost(x, change))

    def linear_step(self, before: _Iterate, x: Array) -> _Iterate:
        """Take a step that is so small that the response is extrapolated by its slopes."""
        step = (x - before.x) / np.array([parameter.unit_size for parameter in self.parameters])
        change = before.change + before.slopes @ step
        return _Iterate(x, change, before.slopes, self._cost(x, change))

    def broyden_step(self, before: _Iterate, x: Array) -> _Iterate:
        """Take a step, and correct the slopes so that they explain it (Broyden 1965)."""
        change = self.response.change(self._settings(x))
        step = (x - before.x) / np.array([parameter.unit_size for parameter in self.parameters])
        missed = change - before.change - before.slopes @ step
        slopes = before.slopes + np.outer(missed, step / max(step @ step, 1e-300))
        return _Iterate(x, change, slopes, self._cost(x, change))

    @property
    def offsets(self) -> Ints:
        """Indices at which the parameters of the next hypothesis begin."""
        return np.cumsum([len(hypothesis.parameters) for hypothesis in self.hypotheses])[:-1]

    def _settings(self, x: Array) -> dict[Hypothesis, Array]:
        return dict(zip(self.hypotheses, np.split(x, self.offsets), strict=True))

    def _cost(self, x: Array, change: Array) -> float:
        rest = self.y - self.equations.whiten(change)
        return residual_deviance(self.equations, rest) + float(np.sum(self._shape(x) ** 2))

    def sigma(self, current: _Iterate) -> Array:
        """Compute standard deviations per typical size, with nuisances free."""
        information, _ = self._normal(current.slopes, np.zeros(self.y.size))
        return np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-12, hermitian=True)))

    def reported_sigma(self, current: _Iterate) -> Array:
        """Return the standard deviations; NaN for shape parameters that the data do not determine."""
        sigma, is_shape = (
            self.sigma(current),
            np.array([not parameter.is_amplitude for parameter in self.parameters]),
        )
        return np.where(is_shape & (sigma > INFORMATIVE_SHARE * SHAPE_PRIOR_SIGMA), np.nan, sigma)

    def step(self, current: _Iterate, room: Array) -> Array:
        """Compute the Gauss-Newton step within the bounds, in typical sizes."""
        rest = self.y - self.equations.whiten(current.change)
        information, gradient = self._normal(current.slopes, rest)
        gradient = gradient - self._shape(current.x) / SHAPE_PRIOR_SIGMA
        small = 1e-12 * max(np.trace(information), 1e-12)
        L = np.linalg.cholesky(information + small * np.eye(current.x.size))
        room = np.stack([np.minimum(room[0], -1e-12), np.maximum(room[1], 1e-12)])
        return np.asarray(lsq_linear(L.T, np.linalg.solve(L, gradient), room).x)

    @property
    def _N(self) -> Array:
        return self.equations.A[:, : self.equations.q]

    def _normal(self, slopes: Array, rest: Array) -> tuple[Array, Array]:
        """Return information and gradient with nuisances eliminated and the prior of shape parameters."""
        S = self.equations.whiten(slopes)
        across = S.T @ self._N
        is_shape = np.array([not parameter.is_amplitude for parameter in self.parameters])
        information = (
            S.T @ S - across @ self.equations.C[-1] @ across.T + np.diag(is_shape / SHAPE_PRIOR_SIGMA**2)
        )
        return information, S.T @ rest - across @ (self.equations.C[-1] @ (self._N.T @ rest))

    def _shape(self, x: Array) -> Array:
        """Return the departure of shape parameters from typical, in prior sigmas."""
        return np.array([
            0.0 if p.is_amplitude else (v - p.typical) / p.unit_size / SHAPE_PRIOR_SIGMA
            for v, p in zip(x, self.parameters, strict=True)
        ])  # fmt: skip
