"""Effects fitted where they are no straight lines: half of them bend at the size that they have.

Gauss-Newton on the whitened residual w(y - f(x)) - N v, with f(x) what the effects change, over all
parameters x of the effects (those that only shape them, too) within their bounds; nuisances v are refitted in
every step with their prior.
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


@dataclass(frozen=True, slots=True, eq=False)
class QuadraticSurrogate:
    """What effects change in the features; beyond what was simulated each goes on in a straight line."""

    sensitivities: Sensitivities

    def change(self, settings: Mapping[Hypothesis, Array]) -> Array:
        """By these values of all parameters of each effect, (m,); those that only shape change nothing."""
        total = np.zeros(self.sensitivities.layout.size)
        for hypothesis, values in settings.items():
            columns, t = self._departures(hypothesis, values)
            inside = self._within_reach(columns, t)
            total += self.sensitivities.effect[:, columns] @ t
            total += self.sensitivities.curve[:, columns] @ (inside * (2.0 * t - inside))
        return total

    def slopes(self, settings: Mapping[Hypothesis, Array], change: Array) -> Array:
        """By each parameter of each effect times its typical size, (m, n), whatever the change."""
        parts = []
        for hypothesis, values in settings.items():
            columns, t = self._departures(hypothesis, values)
            own = self.sensitivities.effect[:, columns]
            own = own + 2.0 * self.sensitivities.curve[:, columns] * self._within_reach(columns, t)
            part = np.zeros((self.sensitivities.layout.size, len(hypothesis.parameters)))
            part[:, [parameter.is_amplitude for parameter in hypothesis.parameters]] = own
            parts.append(part)
        return np.hstack(parts)

    def _within_reach(self, columns: Ints, t: Array) -> Array:
        """The part of sizes that was simulated."""
        reach = self.sensitivities.reach[columns]
        return np.clip(t, -reach, reach)

    def _departures(self, hypothesis: Hypothesis, values: Array) -> tuple[Ints, Array]:
        """Its columns, and its sizes in typical ones."""
        columns = np.flatnonzero(self.sensitivities.owner == self.sensitivities.hypotheses.index(hypothesis))
        return columns, hypothesis.departures(values)


MAX_STEPS: Final = 5
SHAPE_STEP: Final = 0.1
"""Share of a typical size over which the simulator is differentiated by what only shapes."""
CONVERGED_SIGMAS: Final = 1.0
"""A step that moves everything by less than this share of its sigma is the last: so far slopes are right."""
MAX_HALVINGS: Final = 2
BOUND_TOLERANCE: Final = 1e-6
"""Share of a typical size by which one that is fitted to its bound may stay short of it."""
SHAPE_PRIOR_SIGMA: Final = 1.0
"""Of parameters that only shape: about their typical value, as a share of it."""

INFORMATIVE_SHARE: Final = 0.5
"""Share of that to which data must narrow them to say anything of them."""


class EffectResponse(Protocol):
    """What effects change in the features."""

    def change(self, settings: Mapping[Hypothesis, Array]) -> Array:
        """By these values of all parameters of each effect, (m,)."""

    def slopes(self, settings: Mapping[Hypothesis, Array], change: Array) -> Array:
        """By each parameter of each effect times its typical size, (m, n), where `change` is known."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatorResponse:
    """By the simulator; slopes of sizes are those of the parabolas, near enough to set out along."""

    simulator: Simulator
    surrogate: QuadraticSurrogate

    def change(self, settings: Mapping[Hypothesis, Array]) -> Array:
        """One run of the simulator."""
        zero = np.zeros(len(self.simulator.nuisances))
        return np.asarray(self.simulator.predict(settings, zero) - self.simulator.predict({}, zero))

    def slopes(self, settings: Mapping[Hypothesis, Array], change: Array) -> Array:
        """One more run for each parameter that only shapes."""
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
        by, there = SHAPE_STEP * parameter.unit_size, values.copy()
        there[at] += by if values[at] + by <= parameter.most else -by
        apart = self.change({**settings, hypothesis: there}) - change
        return np.asarray(
            apart
            * parameter.unit_size
            * (-1.0 if parameter.typical < 0.0 else 1.0)
            / (there[at] - values[at])
        )


@dataclass(frozen=True, slots=True, eq=False)
class NonlinearFit:
    """The most probable values of some effects."""

    hypotheses: tuple[Hypothesis, ...]
    values: tuple[Array, ...]
    """Of all parameters of each, in their units."""
    sigma: tuple[Array, ...]
    """One sigma of each, nuisances free; NaN of what only shapes, where data tell little of it."""
    at_bound: tuple[tuple[str, ...], ...]
    """Names of those that are at a bound: no finding."""
    change: Array
    """What the effects change in the features, (m,)."""
    slopes: tuple[Array, ...]
    """Derivatives of the features by each parameter times its typical size, (m, k) of each."""
    cost: float
    """Deviance that they leave, and what departures of their shapes add."""

    def in_order(self, order: Sequence[int]) -> "NonlinearFit":
        """The same effects in another order: which of these is the first, and so on."""
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
    """Of whitened features (m,), from starting values of all parameters of each effect."""
    who = tuple(start)
    parameters = tuple(parameter for hypothesis in who for parameter in hypothesis.parameters)
    unit = np.array([parameter.unit_size for parameter in parameters])
    ends = np.array([[p.least for p in parameters], [p.most for p in parameters]])
    fit = _GaussNewton(response, equations, whitened, who, parameters)
    x = np.clip(np.concatenate([start[hypothesis] for hypothesis in who]), *ends)
    there = fit.evaluate(x)
    for _ in range(MAX_STEPS):
        step = fit.step(there, (ends - x) / unit)
        if np.all(np.abs(step) < CONVERGED_SIGMAS * fit.sigma(there)):
            there = fit.linear_step(there, np.clip(x + unit * step, *ends))
            x = there.x
            break
        tries = (
            fit.broyden_step(there, np.clip(x + unit * s, *ends))
            for s in step * 0.5 ** np.arange(MAX_HALVINGS)[:, None]
        )
        better = next((one for one in tries if one.cost < there.cost), None)
        if better is None:
            break
        there, x = better, better.x
    reached = np.any(np.abs(x - ends) <= BOUND_TOLERANCE * unit, axis=0)
    ended = [p.name if at and p.is_amplitude else "" for p, at in zip(parameters, reached, strict=True)]
    names = tuple(
        tuple(n for n in part if n) for part in np.split(np.array(ended, dtype=object), fit.offsets)
    )
    return NonlinearFit(
        who,
        tuple(np.split(x, fit.offsets)),
        tuple(np.split(unit * fit.reported_sigma(there), fit.offsets)),
        names,
        there.change,
        tuple(np.split(there.slopes, fit.offsets, axis=1)),
        there.cost,
    )


def linearise_at(hypothesis: Hypothesis, values: Array, change: Array, slopes: Array) -> Array:
    """One effect as columns about its estimate, (m, k): the whole change, then what else it may do.

    The whole change is what it is at the estimate, so that a straight line through none and the estimate is
    in the span, and so are all small departures from the estimate.
    """
    sized = [i for i, parameter in enumerate(hypothesis.parameters) if parameter.is_amplitude]
    largest = int(np.argmax(np.abs(hypothesis.departures(values))))
    others = [i for k, i in enumerate(sized) if k != largest]
    return np.column_stack([change, *(slopes[:, i] for i in others)])


@dataclass(frozen=True, slots=True, eq=False)
class _Iterate:
    """Where a fit stands."""

    x: Array
    change: Array
    slopes: Array
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class _GaussNewton:
    """A cost and its derivatives; slopes have the sign of the parameters' typical sizes taken off."""

    response: EffectResponse
    equations: NormalEquations
    y: Array
    hypotheses: tuple[Hypothesis, ...]
    parameters: tuple[Parameter, ...]

    def evaluate(self, x: Array) -> _Iterate:
        """All that is known where the fit begins."""
        settings = self._settings(x)
        change = self.response.change(settings)
        slopes = self.response.slopes(settings, change)
        signs = np.array([-1.0 if parameter.typical < 0.0 else 1.0 for parameter in self.parameters])
        return _Iterate(x, change, slopes * signs, self._cost(x, change))

    def linear_step(self, before: _Iterate, x: Array) -> _Iterate:
        """After a step so small that the response need not be asked."""
        step = (x - before.x) / np.array([parameter.unit_size for parameter in self.parameters])
        change = before.change + before.slopes @ step
        return _Iterate(x, change, before.slopes, self._cost(x, change))

    def broyden_step(self, before: _Iterate, x: Array) -> _Iterate:
        """After a step: slopes are mended so that they explain it (Broyden 1965)."""
        change = self.response.change(self._settings(x))
        step = (x - before.x) / np.array([parameter.unit_size for parameter in self.parameters])
        missed = change - before.change - before.slopes @ step
        slopes = before.slopes + np.outer(missed, step / max(step @ step, 1e-300))
        return _Iterate(x, change, slopes, self._cost(x, change))

    @property
    def offsets(self) -> Ints:
        """Where among all parameters those of the next hypothesis begin."""
        return np.cumsum([len(hypothesis.parameters) for hypothesis in self.hypotheses])[:-1]

    def _settings(self, x: Array) -> dict[Hypothesis, Array]:
        return dict(zip(self.hypotheses, np.split(x, self.offsets), strict=True))

    def _cost(self, x: Array, change: Array) -> float:
        rest = self.y - self.equations.whiten(change)
        return residual_deviance(self.equations, rest) + float(np.sum(self._shape(x) ** 2))

    def sigma(self, there: _Iterate) -> Array:
        """Of the parameters per typical size, nuisances free."""
        information, _ = self._normal(there.slopes, np.zeros(self.y.size))
        return np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-12, hermitian=True)))

    def reported_sigma(self, there: _Iterate) -> Array:
        """The same; NaN of those that the data do not tell."""
        sigma, only = (
            self.sigma(there),
            np.array([not parameter.is_amplitude for parameter in self.parameters]),
        )
        return np.where(only & (sigma > INFORMATIVE_SHARE * SHAPE_PRIOR_SIGMA), np.nan, sigma)

    def step(self, there: _Iterate, room: Array) -> Array:
        """The best step within the bounds, per typical size."""
        rest = self.y - self.equations.whiten(there.change)
        information, gradient = self._normal(there.slopes, rest)
        gradient = gradient - self._shape(there.x) / SHAPE_PRIOR_SIGMA
        small = 1e-12 * max(np.trace(information), 1e-12)
        L = np.linalg.cholesky(information + small * np.eye(there.x.size))
        room = np.stack([np.minimum(room[0], -1e-12), np.maximum(room[1], 1e-12)])
        return np.asarray(lsq_linear(L.T, np.linalg.solve(L, gradient), room).x)

    @property
    def _N(self) -> Array:
        return self.equations.A[:, : self.equations.q]

    def _normal(self, slopes: Array, rest: Array) -> tuple[Array, Array]:
        """Information and gradient with nuisances free; what only shapes has its prior."""
        S = self.equations.whiten(slopes)
        across = S.T @ self._N
        only = np.array([not parameter.is_amplitude for parameter in self.parameters]) / SHAPE_PRIOR_SIGMA**2
        information = S.T @ S - across @ self.equations.C[-1] @ across.T + np.diag(only)
        return information, S.T @ rest - across @ (self.equations.C[-1] @ (self._N.T @ rest))

    def _shape(self, x: Array) -> Array:
        """Departure of what only shapes from typical, in sigmas."""
        return np.array([
            0.0 if p.is_amplitude else (v - p.typical) / p.unit_size / SHAPE_PRIOR_SIGMA
            for v, p in zip(x, self.parameters, strict=True)
        ])  # fmt: skip
