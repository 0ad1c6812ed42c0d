"""Fit the sizes of effects: many small robust least-squares problems, which share their simulations.

Each hypothesis frees a few sizes and reads the residuals of one joint, or of all. scipy fits one problem at
a time; here all advance together, because an engine simulates a hundred candidates at the price of ten.
Hypotheses at different joints share a candidate where one joint scarcely moves another (`diagnosis.sharing`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.arrays import Array, Integers
from diagnosis.effects.effect import Effect, Size
from diagnosis.residuals import ResidualModel
from diagnosis.sharing import ALL_JOINTS, Sharing

STEP: Final = 0.05
"""Finite-difference step over the typical size: more than one stick or slip changes, small beside it."""
DAMPINGS: Final = (0.1, 1.0, 10.0)
"""Factors on the Levenberg-Marquardt damping that are tried at once."""
CONVERGED: Final = 1e-3
"""Relative decrease of the loss below which a fit has converged; selection asks for changes of percents."""
MAX_ITERATIONS: Final = 12
AT_ONCE: Final = 100
"""Most candidates in a call of the model: more cost as much each, and no progress would be told meanwhile."""


@dataclass(frozen=True, slots=True)
class Union:
    """All effects that are fitted in a diagnosis, and the place of their sizes in one vector."""

    effects: tuple[Effect, ...]

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Sizes of all effects, one after the other."""
        return tuple(size for effect in self.effects for size in effect.sizes)

    def columns(self, effects: Sequence[Effect]) -> Integers:
        """Return the columns of the sizes of these effects.

        Args:
            effects: Members of the union.

        Returns:
            Indices, (n_sizes,).
        """
        starts = np.cumsum([0, *(len(effect.sizes) for effect in self.effects)])
        where = {effect.key: k for k, effect in enumerate(self.effects)}
        chosen = [where[effect.key] for effect in effects]
        ranges = [np.arange(starts[k], starts[k + 1]) for k in chosen]
        return np.concatenate([np.empty(0, np.int64), *ranges]).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Sizes that are free, where they start, and the residuals that they have to explain."""

    columns: Integers
    """Free columns of the union, (p,)."""
    start: Array
    """Sizes of the whole union, (n_sizes,)."""
    joint: int = ALL_JOINTS
    """Index of the joint whose residuals count."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Hypothesis at its optimum."""

    sizes: Array
    """(n_sizes,)."""
    columns: Integers
    residuals: Array
    """Residuals of its joint, (n_rows,)."""
    rows: Integers
    """Their indices in the residual model."""
    jacobian: Array
    """Derivatives of the residuals by the free sizes, (n_rows, p)."""


def pseudo_huber(z: Array) -> Array:
    """Compute the loss: the square of small residuals, twice the absolute value of large ones.

    Args:
        z: Residuals over their scale, (n,), unitless.

    Returns:
        Losses, (n,).
    """
    loss: Array = 2.0 * (np.sqrt(1.0 + z * z) - 1.0)
    return loss


def half_loss_derivatives(z: Array) -> tuple[Array, Array]:
    """Compute the first two derivatives of half the pseudo-Huber loss.

    Args:
        z: Residuals over their scale, (n,), unitless.

    Returns:
        Slope and curvature, (n,) each.
    """
    return z / np.sqrt(1.0 + z * z), (1.0 + z * z) ** -1.5


def gather_residuals(fits: Sequence[Fit], n_rows: int) -> Array:
    """Put the residuals of the joints in one array.

    Args:
        fits: One fit a joint.
        n_rows: Number of residuals of all joints.

    Returns:
        (n_rows,), in the unit of the model.
    """
    together = np.zeros(n_rows)
    for fit in fits:
        together[fit.rows] = fit.residuals
    return together


def scale_residuals(model: ResidualModel, residuals: Array) -> Array:
    """Return a robust standard deviation for the residuals of each joint.

    Args:
        model: The residual model.
        residuals: (n,), in the unit of the model.

    Returns:
        Scales by joint, (n_joints,), 1.4826 times the median of the absolute residuals.
    """
    scales = np.ones(len(model.joints))
    for joint in range(len(model.joints)):
        chosen = np.abs(residuals[model.joint_of == joint])
        if len(chosen):
            scales[joint] = max(1.4826 * float(np.median(chosen)), 1e-9)
    return scales


def fit_hypotheses(
    model: ResidualModel,
    union: Union,
    hypotheses: Sequence[Hypothesis],
    scales: Array,
    *,
    sharing: Sharing,
    iterations: int = MAX_ITERATIONS,
    report: Callable[[int], None] | None = None,
) -> list[Fit]:
    """Fit hypotheses together by Levenberg-Marquardt with a pseudo-Huber loss.

    Args:
        model: The residual model.
        union: Effects, and the columns of their sizes.
        hypotheses: Problems to solve.
        scales: Scale of the residuals of each joint, (n_joints,), in the unit of the model.
        sharing: Joints whose hypotheses may share a candidate.
        iterations: Most iterations.
        report: Called with the number of candidates after each call of the model.

    Returns:
        One fit a hypothesis, in their order.
    """
    evaluate = _Evaluator(model, union, sharing, report)
    problems = [_Problem(model, union, hypothesis, scales) for hypothesis in hypotheses]
    for problem, rows in zip(problems, evaluate([[one.x] for one in problems], problems), strict=True):
        problem.begin(rows[0])
    for _ in range(iterations):
        active = [one for one in problems if not one.converged]
        if not active:
            break
        steps = [one.difference_points() for one in active]
        for problem, rows in zip(active, evaluate(steps, active), strict=True):
            problem.set_jacobian(rows)
        trials = [one.trial_points() for one in active]
        for problem, rows in zip(active, evaluate(trials, active), strict=True):
            problem.choose(rows)
    return [one.fit() for one in problems]


def evaluate_points(
    model: ResidualModel,
    union: Union,
    points: Sequence[tuple[int, Array]],
    *,
    sharing: Sharing,
    report: Callable[[int], None] | None = None,
) -> list[Array]:
    """Simulate single points, those of different joints in one candidate if they may share it.

    Args:
        model: The residual model.
        union: Effects, and the columns of their sizes.
        points: Joint, or ALL_JOINTS, and sizes of the union in their units, (n_sizes,), for each.
        sharing: Joints whose points may share a candidate.
        report: Called with the number of candidates after each call of the model.

    Returns:
        Residuals of its joint for each point, (n_rows,).
    """
    none = np.empty(0, np.int64)
    ones = np.ones(len(model.joints))
    problems = [_Problem(model, union, Hypothesis(none, at, joint), ones) for joint, at in points]
    found = _Evaluator(model, union, sharing, report)([[at] for _, at in points], problems)
    return [rows[0] for rows in found]


class _Problem:
    """One hypothesis on its way to its optimum."""

    def __init__(self, model: ResidualModel, union: Union, hypothesis: Hypothesis, scales: Array) -> None:
        sizes = union.sizes
        self.hypothesis = hypothesis
        self.free = hypothesis.columns
        self.x = hypothesis.start.copy()
        self.low = np.array([sizes[c].low for c in self.free])
        self.high = np.array([sizes[c].high for c in self.free])
        self.x[self.free] = np.clip(self.x[self.free], self.low, self.high)
        self.typical = np.array([sizes[c].typical for c in self.free])
        prior = np.array([sizes[c].prior_std for c in self.free])
        self.prior_weight = 1.0 / prior  # 0 where the prior is flat
        wanted = np.ones(len(model.joint_of), bool)
        if hypothesis.joint != ALL_JOINTS:
            wanted &= model.joint_of == hypothesis.joint
        self.rows = np.flatnonzero(wanted)
        self.weight = 1.0 / scales[model.joint_of[self.rows]]
        self.damping, self.converged = 1e-2, False
        self.jacobian = np.zeros((len(self.rows), len(self.free)))

    def begin(self, residuals: Array) -> None:
        self.r, self.loss = residuals, self.loss_of(residuals, self.x)
        self.converged = len(self.free) == 0

    def loss_of(self, residuals: Array, x: Array) -> float:
        loss = float(np.sum(pseudo_huber(residuals * self.weight)))
        loss += float(np.sum((x[self.free] * self.prior_weight) ** 2))
        return loss if np.isfinite(loss) else np.inf

    def difference_points(self) -> list[Array]:
        """Return a point for each free size, one step away on the side of its farther bound."""
        at = self.x[self.free]
        step = STEP * np.maximum(self.typical, np.abs(at))
        step = np.where(at + step > self.high, -step, step)
        self.steps = np.clip(at + step, self.low, self.high) - at
        points = []
        for k, column in enumerate(self.free):
            point = self.x.copy()
            point[column] += self.steps[k]
            points.append(point)
        return points

    def set_jacobian(self, rows: list[Array]) -> None:
        for k, moved in enumerate(rows):
            change = (moved - self.r) / self.steps[k] if self.steps[k] else np.zeros_like(self.r)
            self.jacobian[:, k] = np.where(np.isfinite(change), change, 0.0)

    def trial_points(self) -> list[Array]:
        """Return the end of a step for each damping, inside the bounds."""
        z = self.r * self.weight
        robust = self.weight * (1.0 + z * z) ** -0.25
        a = self.jacobian * robust[:, None]
        gradient = a.T @ (self.r * robust) + self.prior_weight**2 * self.x[self.free]
        hessian = a.T @ a + np.diag(self.prior_weight**2)
        at = self.x[self.free]
        held = ((at <= self.low) & (gradient > 0)) | ((at >= self.high) & (gradient < 0))
        go = np.flatnonzero(~held)
        self.trials = []
        for factor in DAMPINGS:
            point = self.x.copy()
            if len(go):
                block = hessian[np.ix_(go, go)]
                scale = np.diag(block) + 1e-12 * np.max(np.diag(hessian), initial=1e-300)
                step = np.linalg.solve(block + self.damping * factor * np.diag(scale), -gradient[go])
                point[self.free[go]] = np.clip(at[go] + step, self.low[go], self.high[go])
            self.trials.append(point)
        return self.trials

    def choose(self, rows: list[Array]) -> None:
        losses = [self.loss_of(moved, point) for moved, point in zip(rows, self.trials, strict=True)]
        best = int(np.argmin(losses))
        if losses[best] < self.loss:
            self.converged = self.loss - losses[best] < CONVERGED * self.loss
            self.x, self.r, self.loss = self.trials[best], rows[best], losses[best]
            self.damping *= DAMPINGS[best]
        else:
            self.converged = self.damping > 1e3  # a step of a thousandth of the model's own finds nothing
            self.damping *= 100.0

    def fit(self) -> Fit:
        return Fit(self.x, self.free, self.r, self.rows, self.jacobian)


class _Evaluator:
    """Simulates the points of many problems in as few candidates as possible."""

    def __init__(
        self, model: ResidualModel, union: Union, sharing: Sharing, report: Callable[[int], None] | None
    ) -> None:
        self.model, self.union, self.sharing, self.report = model, union, sharing, report

    def __call__(self, points: list[list[Array]], problems: Sequence[_Problem]) -> list[list[Array]]:
        """Return the residuals of each problem at each of its points."""
        where = [(k, i) for k, wanted in enumerate(points) for i in range(len(wanted))]
        plan = self.sharing.plan([(problems[k].hypothesis.joint, points[k][i]) for k, i in where])
        candidates = []
        for numbers in plan:
            members = [where[number] for number in numbers]
            candidates.append((members, self.merge([(problems[k], points[k][i]) for k, i in members])))
        if not candidates:
            return [[] for _ in points]
        found: dict[tuple[int, int], Array] = {}
        for first in range(0, len(candidates), AT_ONCE):
            self.simulate(candidates[first : first + AT_ONCE], problems, found)
        return [[found[k, i] for i in range(len(wanted))] for k, wanted in enumerate(points)]

    def simulate(
        self,
        candidates: list[tuple[list[tuple[int, int]], Array]],
        problems: Sequence[_Problem],
        found: dict[tuple[int, int], Array],
    ) -> None:
        """Simulate candidates, and add the residuals of each point to what is found."""
        used = np.flatnonzero(np.any([point != 0.0 for _, point in candidates], axis=0))
        part = [e for e in self.union.effects if np.isin(self.union.columns([e]), used).any()]
        sizes = np.array([point[self.union.columns(part)] for _, point in candidates])
        simulated = self.model.residuals(part, sizes)
        for (members, _), row in zip(candidates, simulated, strict=True):
            for k, i in members:
                found[k, i] = row[problems[k].rows]
        if self.report is not None:
            self.report(len(candidates))

    def merge(self, members: list[tuple[_Problem, Array]]) -> Array:
        """Return one size vector with the sizes of each problem at the joint of the problem."""
        place_of = np.array([effect.place for effect in self.union.effects for _ in effect.sizes])
        merged = members[0][1].copy()
        for problem, point in members[1:]:
            mine = place_of == self.model.joints[problem.hypothesis.joint]
            merged[mine] = point[mine]
        return merged
