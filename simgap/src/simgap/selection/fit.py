"""Fit the sizes of effects: many small robust least-squares problems, which share their simulations.

Each hypothesis frees a few sizes and reads the residuals of one joint, or of all. scipy fits one problem at
a time; here all advance together, because an engine simulates a hundred candidates at the price of ten.
Hypotheses at different joints share a candidate where one joint scarcely moves another (`sharing.py`).

Residuals are arrays (n,) in the unit of the model, scales (n_joints,) too; columns are indices, (n_sizes,).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.effects.effect import Effect, Size
from simgap.residuals.residuals import ResidualModel, pseudo_huber, residuals_by_motion, root_weight
from simgap.selection.sharing import ALL_JOINTS, Point, Sharing

STEP: Final = 0.05
"""Finite-difference step over the typical size: more than one stick or slip changes, small beside it."""
DAMPINGS: Final = (0.3, 3.0)
"""Factors on the Levenberg-Marquardt damping that are tried at once."""
CONVERGED: Final = 1e-3
"""Relative decrease of the loss below which a fit has converged; selection asks for changes of percents."""
MAX_ITERATIONS: Final = 12
SQUARES: Final = 100.0
"""Scale of the loss over the largest residual at which it is a sum of squares, to 1e-4."""
AT_ONCE: Final = 100
"""Most candidates in a call of the model: more cost as much each, and no progress would be told meanwhile."""


@dataclass(frozen=True)
class Union:
    """All effects that are fitted in a diagnosis, and the place of their sizes in one vector."""

    effects: tuple[Effect, ...]

    @cached_property
    def sizes(self) -> tuple[Size, ...]:
        """Sizes of all effects, one after the other."""
        return tuple(size for effect in self.effects for size in effect.sizes)

    @cached_property
    def owner(self) -> Integers:
        """Index of the effect of each column, (n_sizes,)."""
        return np.repeat(np.arange(len(self.effects)), [len(effect.sizes) for effect in self.effects])

    def sizes_at(self, columns: Integers) -> list[Size]:
        """Return the sizes in these columns."""
        sizes = self.sizes
        return [sizes[c] for c in columns]

    def columns(self, effects: Sequence[Effect]) -> Integers:
        """Return the columns of the sizes of these effects, (n_sizes,) indices."""
        return np.concatenate([np.empty(0, np.int64), *(self._columns[effect.key] for effect in effects)])

    @cached_property
    def _columns(self) -> dict[str, Integers]:
        """Columns of the sizes of each effect, by its key."""
        starts = np.cumsum([0, *(len(effect.sizes) for effect in self.effects)])
        ranges = pairwise(starts)
        return {
            effect.key: np.arange(first, last, dtype=np.int64)
            for effect, (first, last) in zip(self.effects, ranges, strict=True)
        }


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Sizes that are free, where they start, and the residuals that they have to explain."""

    columns: Integers
    """Free columns of the union, (p,)."""
    start: Array
    """Sizes of the whole union, (n_sizes,)."""
    joint: int = ALL_JOINTS
    """Index of the joint whose residuals count."""
    jacobian: Array | None = None
    """Derivatives to begin with, (n_rows, p), from a fit that is near; NaN in columns that are not known."""


@dataclass(frozen=True, slots=True)
class JointFit:
    """Hypothesis at its optimum."""

    sizes: Array
    """(n_sizes,)."""
    columns: Integers
    joint: int
    """Index of the joint, or ALL_JOINTS."""
    residuals: Array
    """Residuals of its joint, (n_rows,)."""
    rows: Integers
    """Their indices in the residual model."""
    jacobian: Array
    """Derivatives of the residuals by the free sizes, (n_rows, p)."""


def gather_residuals(fits: Sequence[JointFit], n_rows: int) -> Array:
    """Put the residuals of the joints in one array, (n_rows,), in the unit of the model."""
    together = np.zeros(n_rows)
    for fit in fits:
        together[fit.rows] = fit.residuals
    return together


def scale_residuals(model: ResidualModel, residuals: Array) -> Array:
    """Return a robust deviation for each joint, (n_joints,): 1.4826 times the median absolute residual.

    Known noise is normal, and its loss is a sum of squares: that of a scale which no residual comes near.
    """
    scales = np.ones(len(model.joints))
    if model.noise_std:
        return SQUARES * max(model.noise_std, float(np.max(np.abs(residuals), initial=0.0))) * scales
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
) -> list[JointFit]:
    """Fit hypotheses together by Levenberg-Marquardt with a pseudo-Huber loss.

    Args:
        sharing: Joints whose hypotheses may share a candidate.
        report: Called with the number of candidates after each call of the model.
    """
    evaluate = _Evaluator(model, union, sharing, report)
    problems = [_Problem(model, union, hypothesis, scales, sharing) for hypothesis in hypotheses]
    starts = [[(one.joint, one.x)] for one in problems]
    for problem, found in zip(problems, evaluate(starts), strict=True):
        problem.begin(found[0])
    for _ in range(iterations):
        active = [one for one in problems if not one.converged]
        if not active:
            break
        differences = [one.difference_points() for one in active]
        for problem, found in zip(active, evaluate(differences), strict=True):
            problem.set_derivatives(found)
        trials = [one.trial_points() for one in active]
        for problem, found in zip(active, evaluate(trials), strict=True):
            problem.choose(found)
    return [one.fit() for one in problems]


def evaluate_points(
    model: ResidualModel,
    union: Union,
    points: Sequence[Point],
    *,
    sharing: Sharing,
    report: Callable[[int], None] | None = None,
) -> list[Array]:
    """Simulate single points, those of different joints in one candidate if they may share it.

    Args:
        points: Joint, or ALL_JOINTS, and sizes of the union in their units, for each: all (n_sizes,), or all
            (n_motions, n_sizes).
        sharing: Joints whose points may share a candidate.
        report: Called with the number of candidates after each call of the model.

    Returns:
        Residuals of its joint for each point, (n_rows,).
    """
    (found,) = _Evaluator(model, union, sharing, report)([list(points)])
    return found


class _Problem:
    """One hypothesis on its way to its optimum.

    Between two computations of the derivatives by differences, each step corrects them by a rank of one so
    that they predict its change (Broyden 1965). A step that fails, or that decreases the loss no more, asks
    for new differences: only then is the end of a fit believed.
    """

    def __init__(
        self, model: ResidualModel, union: Union, hypothesis: Hypothesis, scales: Array, sharing: Sharing
    ) -> None:
        self.joint, self.free = hypothesis.joint, hypothesis.columns
        sizes = union.sizes_at(self.free)
        self.x = hypothesis.start.copy()
        self.low = np.array([size.low for size in sizes])
        self.high = np.array([size.high for size in sizes])
        self.x[self.free] = np.clip(self.x[self.free], self.low, self.high)
        self.typical = np.array([size.typical for size in sizes])
        prior = np.array([size.prior_std for size in sizes])
        self.prior_weight = 1.0 / prior  # 0 where the prior is flat
        self.rows = select_rows(model, self.joint)
        self.weight = 1.0 / scales[model.joint_of[self.rows]]
        self.damping, self.converged = 1e-2, False
        # a size that moves its joint alone is differenced there, so that several share a candidate
        moves = np.full(len(self.free), self.joint)
        if self.joint == ALL_JOINTS:
            far = np.isin(self.free, sharing.reaching)
            moves = np.where(far, ALL_JOINTS, sharing.joint_of_column[self.free])
        self.moves = [int(joint) for joint in moves]
        self.part = {j: np.arange(self.rows.size) for j in (self.joint,)}
        self.part |= {j: select_rows(model, j) for j in set(self.moves) - {self.joint}}
        given = hypothesis.jacobian
        shape = self.rows.size, len(self.free)
        self.jacobian = np.full(shape, np.nan) if given is None else given.copy()
        self.unknown: Flags = np.asarray(np.isnan(self.jacobian).any(axis=0))
        self.jacobian[:, self.unknown] = 0.0
        self.is_exact = False

    def begin(self, residuals: Array) -> None:
        self.r, self.loss = residuals, self.loss_of(residuals, self.x)
        self.converged = len(self.free) == 0

    def loss_of(self, residuals: Array, x: Array) -> float:
        loss = float(np.sum(pseudo_huber(residuals * self.weight)))
        loss += float(np.sum((x[self.free] * self.prior_weight) ** 2))
        return loss if np.isfinite(loss) else np.inf

    def difference_points(self) -> list[Point]:
        """Return a point for each unknown derivative, one step away on the side of its farther bound."""
        at = self.x[self.free]
        step = STEP * np.maximum(self.typical, np.abs(at))
        step = np.where(at + step > self.high, -step, step)
        self.steps = np.clip(at + step, self.low, self.high) - at
        points = []
        for k in np.flatnonzero(self.unknown):
            point = self.x.copy()
            point[self.free[k]] += self.steps[k]
            points.append((self.moves[k], point))
        return points

    def set_derivatives(self, found: list[Array]) -> None:
        for k, moved in zip(np.flatnonzero(self.unknown), found, strict=True):
            rows, self.jacobian[:, k] = self.part[self.moves[k]], 0.0
            if self.steps[k]:
                change = (moved - self.r[rows]) / self.steps[k]
                self.jacobian[rows, k] = np.where(np.isfinite(change), change, 0.0)
        self.is_exact |= bool(self.unknown.all())
        self.unknown[:] = False

    def trial_points(self) -> list[Point]:
        """Return the end of a step for each damping, inside the bounds."""
        z = self.r * self.weight
        robust = self.weight * root_weight(z)
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
        return [(self.joint, point) for point in self.trials]

    def choose(self, found: list[Array]) -> None:
        losses = [self.loss_of(moved, point) for moved, point in zip(found, self.trials, strict=True)]
        best = int(np.argmin(losses))
        decrease = self.loss - losses[best]
        is_small = not decrease > CONVERGED * self.loss
        if decrease > 0.0:
            if not is_small:  # after a small step the roughness of the residuals would count as a slope
                self.correct(found[best] - self.r, (self.trials[best] - self.x)[self.free])
            self.x, self.r, self.loss = self.trials[best], found[best], losses[best]
            self.damping *= DAMPINGS[best]
            self.converged = is_small and self.is_exact
            self.unknown[:] = is_small
            self.is_exact = False
        elif self.is_exact:
            self.converged = self.damping > 1e3  # a step of a thousandth of the model's own finds nothing
            self.damping *= 100.0
        else:
            self.unknown[:] = True

    def correct(self, change: Array, step: Array) -> None:
        """Correct the derivatives so that they predict the change that a step has made."""
        missed, step = change - self.jacobian @ step, step / self.typical
        slope = step / self.typical / max(float(step @ step), STEP**2)
        for k, joint in enumerate(self.moves):
            rows = self.part[joint]
            self.jacobian[rows, k] += missed[rows] * slope[k]

    def fit(self) -> JointFit:
        return JointFit(self.x, self.free, self.joint, self.r, self.rows, self.jacobian)


class _Evaluator:
    """Simulates the points of many problems in as few candidates as possible."""

    def __init__(
        self, model: ResidualModel, union: Union, sharing: Sharing, report: Callable[[int], None] | None
    ) -> None:
        self.model, self.union, self.sharing, self.report = model, union, sharing, report

    def __call__(self, points: list[list[Point]]) -> list[list[Array]]:
        """Return the residuals of its joint for each point of each problem."""
        where = [(k, i) for k, wanted in enumerate(points) for i in range(len(wanted))]
        flat = [points[k][i] for k, i in where]
        self.rows = {joint: select_rows(self.model, joint) for joint in {joint for joint, _ in flat}}
        plan = self.sharing.plan(flat)
        found: dict[int, Array] = {}
        for first in range(0, len(plan), AT_ONCE):
            self.simulate(plan[first : first + AT_ONCE], flat, found)
        place = {one: number for number, one in enumerate(where)}
        return [[found[place[k, i]] for i in range(len(wanted))] for k, wanted in enumerate(points)]

    def simulate(self, plan: list[list[int]], points: list[Point], found: dict[int, Array]) -> None:
        """Simulate candidates, and add the residuals of each point to what is found."""
        merged = [self.sharing.merge([points[number] for number in numbers]) for numbers in plan]
        sizes = np.array(merged)
        used = np.flatnonzero(np.any(sizes != 0.0, axis=tuple(range(sizes.ndim - 1))))
        part = [self.union.effects[k] for k in np.unique(self.union.owner[used])]
        sizes = sizes[..., self.union.columns(part)]
        if sizes.ndim == 3:
            simulated = residuals_by_motion(self.model, part, sizes)
        else:
            simulated = self.model.residuals(part, sizes)
        for numbers, row in zip(plan, simulated, strict=True):
            for number in numbers:
                found[number] = row[self.rows[points[number][0]]]
        if self.report is not None:
            self.report(len(plan))


def select_rows(model: ResidualModel, joint: int) -> Integers:
    """Return the rows of the residuals of a joint, or of ALL_JOINTS, (n_rows,) indices."""
    return np.arange(len(model.joint_of)) if joint == ALL_JOINTS else np.flatnonzero(model.joint_of == joint)
