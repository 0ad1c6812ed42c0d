"""The way of one hypothesis to its optimum: Levenberg-Marquardt with a pseudo-Huber loss.

A step takes one simulation, and derivatives by differences take one for each size. So differences are taken
seldom. Between them, derivatives are corrected so that they predict the residuals at all points that the
descent has passed since: by least squares, in which near points count most (secants, after Broyden 1965).
"""

from collections.abc import Generator
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags, Slopes, find_bounded_minimum
from simgap.residuals.residuals import ResidualModel, pseudo_huber, root_weight
from simgap.selection.fit import STEP, Hypothesis, JointFit, Union, select_rows
from simgap.selection.sharing import ALL_JOINTS, Point, Sharing

CONVERGED: Final = 1e-4
"""Relative decrease of the loss below which a fit has converged: less than a standard error of a size changes
it where fewer than ten thousand residuals are independent. With 1e-3, tests of a set compared where fits had
stopped."""
DAMPING: Final = 1e-2
"""Damping at the start, over the diagonal of the normal matrix; its usual start is 1e-3 to 1e-2."""
MOST_DAMPING: Final = 1e3
"""A step of a thousandth of the model's own finds nothing."""
FAILURES: Final = 2
"""Steps that fail before new differences are taken: a second one costs less than differences."""
LEAST_DECREASE: Final = 0.1
"""Least decrease of the loss, over what derivatives say, of a step that counts (Nocedal and Wright 2006).
Another may end where a size has no derivative, such as a shape of 0."""
RIDGE: Final = 1e-2
"""Weight, beside the secants, of the derivatives as they were: less than that of any direction passed."""

Requests = Generator[list[Point], list[Array], None]
"""Yields points, and gets the residuals of each, (n_rows,)."""


class Descent:
    """A hypothesis on its way. Its end is believed only with derivatives by differences at it."""

    def __init__(
        self, model: ResidualModel, union: Union, hypothesis: Hypothesis, scales: Array, sharing: Sharing
    ) -> None:
        """Prepare the start; no residual is known yet."""
        self.joint, self.free = hypothesis.joint, hypothesis.columns
        sizes = union.sizes_at(self.free)
        self._low = np.array([size.low for size in sizes])
        self._high = np.array([size.high for size in sizes])
        self._typical = np.array([size.typical for size in sizes])
        self._prior_weight = 1.0 / np.array([size.prior_std for size in sizes])  # 0 where the prior is flat
        self._starts = [self._inside(x) for x in (hypothesis.start, *hypothesis.other_starts)]
        self.rows = select_rows(model, self.joint)
        self._weight = 1.0 / scales[model.joint_of[self.rows]]
        self._moves = self._list_moves(sharing)
        self._part = {j: select_rows(model, j) for j in set(self._moves) - {self.joint}}
        self._part[self.joint] = np.arange(self.rows.size)
        given = hypothesis.jacobian
        self._unknown: Flags = np.ones(len(self.free), dtype=bool)
        if given is not None:
            self._unknown = np.asarray(np.isnan(given).any(axis=0))
        # of a size that moves one joint, the derivatives of the others are none, and would fill the memory
        parts = [self._part[j] for j in self._moves]
        self._derivatives: list[Slopes] = [
            np.zeros(part.size, np.float32) if given is None or unknown else given[part, k]
            for k, (part, unknown) in enumerate(zip(parts, self._unknown, strict=True))
        ]
        self._is_exact, self._damping, self._failures = False, DAMPING, 0
        self._passed: list[tuple[Array, Array]] = []
        self.has_begun, self.has_converged, self._seems_converged = False, len(self.free) == 0, False

    def _inside(self, x: Array) -> Array:
        x = x.copy()
        x[self.free] = np.clip(x[self.free], self._low, self._high)
        return x

    def _list_moves(self, sharing: Sharing) -> list[int]:
        """List the joint that each size moves; where it moves that alone, differences share candidates."""
        if self.joint != ALL_JOINTS:
            return [self.joint] * len(self.free)
        is_far = np.isin(self.free, sharing.reaching)
        return [int(j) for j in np.where(is_far, ALL_JOINTS, sharing.joint_of_column[self.free])]

    def run(self, iterations: int, is_sure: bool) -> Requests:
        """Go on for some iterations, or to the optimum; to be sure of it takes derivatives by differences."""
        if not self.has_begun:
            self._begin((yield [(self.joint, x) for x in self._starts]))
        for _ in range(iterations):
            if self.has_converged:
                return
            if self._unknown.any():
                if self._seems_converged and not is_sure:
                    return
                self._set_derivatives((yield self._difference_points()))
            trial, expected = self._step()
            is_last = expected <= CONVERGED * self.loss
            if is_last and not self._is_exact:
                self._unknown[:], self._seems_converged = True, True
                continue
            if expected > 0.0:  # what a last step gains is small beside the loss, not beside the noise
                (moved,) = yield [(self.joint, trial)]
                self._go(trial, moved, expected)
            self.has_converged |= is_last

    def _begin(self, found: list[Array]) -> None:
        losses = [self.loss_of(residuals, x) for residuals, x in zip(found, self._starts, strict=True)]
        best = int(np.argmin(losses))
        self.sizes, self.residuals, self.loss = self._starts[best], found[best], losses[best]
        self.has_begun = True

    def loss_of(self, residuals: Array, x: Array) -> float:
        """Compute the loss that residuals and the priors of sizes have.

        Args:
            residuals: Those of its joint, (n_rows,), in the unit of the model.
            x: Sizes of the union, (n_sizes,), each in its own unit.
        """
        loss = float(np.sum(pseudo_huber(residuals * self._weight)))
        loss += float(np.sum((x[self.free] * self._prior_weight) ** 2))
        return loss if np.isfinite(loss) else np.inf

    def _difference_points(self) -> list[Point]:
        """Return a point for each unknown derivative, one step up, or down where that leaves the bounds."""
        at = self.sizes[self.free]
        step = STEP * np.maximum(self._typical, np.abs(at))
        step = np.where(at + step > self._high, -step, step)
        self._steps = np.clip(at + step, self._low, self._high) - at
        points = []
        for k in np.flatnonzero(self._unknown):
            point = self.sizes.copy()
            point[self.free[k]] += self._steps[k]
            points.append((self._moves[k], point))
        return points

    def _set_derivatives(self, found: list[Array]) -> None:
        for k, moved in zip(np.flatnonzero(self._unknown), found, strict=True):
            self._derivatives[k] = np.zeros(moved.size, np.float32)
            if self._steps[k]:
                change = (moved - self.residuals[self._part[self._moves[k]]]) / self._steps[k]
                self._derivatives[k][:] = np.where(np.isfinite(change), change, 0.0)
        self._is_exact = bool(self._unknown.all())
        self._unknown[:], self._seems_converged, self._failures = False, False, 0
        self._passed.clear()

    def _step(self) -> tuple[Array, float]:
        """Return the end of a step inside the bounds, and the decrease of the loss that it should make."""
        robust = self._weight * root_weight(self.residuals * self._weight)
        a, prior, at = self._slopes(), self._prior_weight**2, self.sizes[self.free]
        a *= robust[:, None]  # in place, as derivatives at all joints are large
        gradient = a.T @ (self.residuals * robust) + prior * at
        hessian = a.T @ a + np.diag(prior)
        scale = np.diag(hessian) + 1e-12 * np.max(np.diag(hessian), initial=1e-300)
        damped = hessian + self._damping * np.diag(scale)
        end = self.sizes.copy()
        bounds = self._low, self._high
        end[self.free] = find_bounded_minimum(damped, gradient, at, bounds, np.sqrt(scale))
        step = end[self.free] - at
        return end, -float(2.0 * gradient @ step + step @ hessian @ step)

    def _slopes(self) -> Array:
        """Return derivatives at the present sizes, (n_rows, p), that fit to the points passed."""
        slopes = np.zeros((self.rows.size, len(self.free)))
        for k, joint in enumerate(self._moves):
            slopes[self._part[joint], k] = self._derivatives[k]
        if not self._passed:
            return slopes
        steps = np.array([(x - self.sizes[self.free]) / self._typical for x, _ in self._passed])
        changes = np.column_stack([residuals - self.residuals for _, residuals in self._passed])
        changes -= slopes @ (steps * self._typical).T
        square = np.sum(steps**2, axis=1)
        weighted = steps / (square + STEP**2)[:, None]  # nearer than STEP, roughness would count as a slope
        ridge = RIDGE * np.mean(square / (square + STEP**2)) * np.eye(len(self.free))
        correction = np.linalg.solve(weighted.T @ steps + ridge, weighted.T) / self._typical[:, None]
        for k, joint in enumerate(self._moves):
            slopes[self._part[joint], k] += changes[self._part[joint]] @ correction[k]
        return slopes

    def _go(self, trial: Array, moved: Array, expected: float) -> None:
        """Go to the end of a step if the loss decreases enough; set the damping by what was expected."""
        loss, was_exact = self.loss_of(moved, trial), self._is_exact
        decrease = self.loss - loss
        if decrease > LEAST_DECREASE * expected:
            is_small = decrease <= CONVERGED * self.loss
            if not is_small:  # after a small step the roughness of the residuals would count as a slope
                self._passed.append((self.sizes[self.free], self.residuals))
            self.sizes, self.residuals = trial, moved
            self.loss, self._is_exact = loss, False
            self._damping *= 0.3 if decrease > 0.5 * expected else 1.0 if decrease > 0.2 * expected else 3.0
            self.has_converged = is_small and was_exact
            self._unknown[:], self._seems_converged = is_small, is_small
        elif was_exact:
            self._damping = max(10.0 * self._damping, STEP**2)
            self.has_converged = self._damping > MOST_DAMPING
        else:
            self._passed.append((trial[self.free], moved))
            self._damping = max(4.0 * self._damping, STEP**2)
            self._failures += 1
            self._unknown[:] = self._failures >= FAILURES

    def begin_at(self, best: JointFit) -> Hypothesis:
        """Return the hypothesis with the sizes, and derivatives by them, that it shares with a fit."""
        start, jacobian = self.sizes.copy(), self._slopes().astype(np.float32)
        _, here, there = np.intersect1d(self.free, best.columns, return_indices=True)
        start[self.free[here]] = best.sizes[self.free[here]]
        jacobian[:, here] = best.jacobian[:, there]
        return Hypothesis(self.free, start, self.joint, jacobian)

    def fit(self) -> JointFit:
        """Return the hypothesis as it is now."""
        jacobian = self._slopes().astype(np.float32)
        return JointFit(self.sizes, self.free, self.joint, self.residuals, self.rows, jacobian)
