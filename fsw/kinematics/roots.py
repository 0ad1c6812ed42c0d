"""Roots of the deflected arm: fixed-point and Newton iterations from the roots of the orthogonal rigid arm.

The fixed-point iteration serves far from every singularity. Its first step solves the orthogonal rigid arm
for a virtual target: the true target, corrected by the error of the real arm. The others are Newton steps
with the springs held. The load changes little between iterations, so few suffice; each costs one evaluation
of the real arm.

Newton's method converges at double roots as well. With a nearly straight elbow, both elbows may lead to the
same root of the real arm, and that may reach targets that the orthogonal arm misses by some millimetres.
Newton's method finds both roots from a bent elbow on either side: it converges from the convex side of the
fold.

In all functions, `p` are target positions in m and `a` approach directions, unit vectors, both in the rover
frame, (3, n). Matrices `J` and right sides `residual` of linear equations have any unit, batch axes last.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm, limit_excess, wrap_into_limits
from fsw.kinematics.closed_form import Roots, branch_index, closed_form, closed_form_branch, fold_distances
from fsw.kinematics.statics import ROOT_TOLERANCE, approach_jacobian, evaluate_pose, task_error, task_jacobian
from fsw.kinematics.transforms import (
    Array,
    Flags,
    concatenate_records,
    norm,
    record_arrays,
    select_targets,
)

TASK_TOLERANCE: Final = 1e-11
"""Bound of position error [m], axis error [rad] and change of strain at a root."""
STEP_TOLERANCE_RAD: Final = 1e-7
LONGEST_STEP_RAD: Final = 0.4
PASSES: Final = 2
"""Evaluations of load and deflection per step; with one, the strain lags too much at double roots."""
PATIENCE: Final = 15
"""After this many steps, starts far from a root are dropped; after twice as many, all are."""
HOPELESS_ERROR: Final = 1e-3
"""Task error above which a start is far from a root."""
DAMPING: Final = 1e-12
"""Damping of the least-squares inverse."""
NEWTON_BLOCK: Final = 8000
"""Starts that are iterated together, to bound the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class NewtonRoots:
    """Joint angles that put the tool on its target, batch axes trailing."""

    output_rad: Array
    """Output angles, (5, ...)."""
    torque_Nm: Array
    """Torque of gravity on each output at this pose, (5, ...)."""
    error: Array
    """Larger of position error [m] and axis error [rad], (...)."""
    converged: Flags
    """True where the error is below ROOT_TOLERANCE, (...)."""


def refine_roots(
    arm: Arm, tool: str, p_RoTo_R_m: Array, approach_R: Array, gravity_R_m_s2: Array, start_rad: Array
) -> NewtonRoots:
    """Refine starts by Newton steps until the tool meets its target.

    Args:
        start_rad: Output angles to start from, shape (5, ...); starts that are not finite do not converge.
    """
    batch = start_rad.shape[1:]
    p, a = (np.broadcast_to(_column(v, batch), (3, *batch)).reshape(3, -1) for v in (p_RoTo_R_m, approach_R))
    start = start_rad.reshape(5, -1)
    blocks = [slice(k, k + NEWTON_BLOCK) for k in range(0, max(start.shape[1], 1), NEWTON_BLOCK)]
    roots = concatenate_records(
        [_finish(begin_newton(arm, tool, p[:, k], a[:, k], gravity_R_m_s2, start[:, k])) for k in blocks]
    )
    return NewtonRoots(*(v.reshape((*v.shape[:-1], *batch)) for v in record_arrays(roots)))


def begin_newton(
    arm: Arm, tool: str, p: Array, a: Array, gravity_R_m_s2: Array, start_rad: Array
) -> "NewtonSearch | NewtonRoots":
    """Begin the Newton steps from starts (5, n); without a finite start there is nothing to search."""
    n = start_rad.shape[1]
    begun = NewtonRoots(start_rad.astype(float), np.zeros((5, n)), np.full(n, np.inf), np.zeros(n, bool))
    if not np.isfinite(start_rad).all(axis=0).any():
        return begun
    return NewtonSearch(_Newton(arm, tool, p, a, gravity_R_m_s2), None, begun, 0)


def _finish(search: "NewtonSearch | NewtonRoots") -> NewtonRoots:
    while isinstance(search, NewtonSearch):
        search = search.advance()
    return search


@dataclass(frozen=True, slots=True, eq=False)
class NewtonSearch:
    """Newton iteration under way.

    Every step updates the load, so deflection and angles converge together. A secant correction (Broyden)
    learns the part of the Jacobian that the load causes. Without it, double roots do not converge.
    """

    newton: "_Newton"
    moving: "_Iterate | None"
    """Starts that have not converged; None before the first step."""
    roots: NewtonRoots
    """What was found so far, for all starts."""
    steps: int
    """Steps that were taken."""

    def advance(self) -> "NewtonSearch | NewtonRoots":
        """Take one step from each start that has not converged."""
        current = self._begin() if self.moving is None else self.moving
        J_inv = damped_inverse(current.J + current.load_J)
        step = -np.einsum("ij...,j...->i...", J_inv, current.residual)
        step *= np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(np.max(np.abs(step), axis=0), 1e-300))
        current = self.newton.take_step(current, step)
        error = current.error()
        roots = NewtonRoots(*(values.copy() for values in record_arrays(self.roots)))
        roots.output_rad[:, current.where] = current.output_rad
        roots.torque_Nm[:, current.where], roots.error[current.where] = current.torque_Nm, error
        roots.converged[current.where] = error < ROOT_TOLERANCE
        active = (error >= TASK_TOLERANCE) | (np.max(np.abs(step), axis=0) >= STEP_TOLERANCE_RAD)
        active &= np.isfinite(error) & ((self.steps < PATIENCE) | (error < HOPELESS_ERROR))
        if not active.any() or self.steps + 1 == 2 * PATIENCE:
            return roots
        moving = current if active.all() else select_targets(current, active)
        return replace(self, moving=moving, roots=roots, steps=self.steps + 1)

    def _begin(self) -> "_Iterate":
        finite = np.flatnonzero(np.isfinite(self.roots.output_rad).all(axis=0))
        return self.newton.begin(self.roots.output_rad.take(finite, axis=-1), finite)


@dataclass(frozen=True, slots=True, eq=False)
class _Iterate:
    """State of the iteration; the last axis of every field holds the starts, (n,)."""

    where: NDArray[np.intp]
    """Indices of the starts."""
    output_rad: Array
    """Output angles, (5, n)."""
    strain: Array
    """Spring displacements, (6, 6, n)."""
    torque_Nm: Array
    """Torque of the load on each output, (5, n)."""
    strain_change: Array
    """Change of strain in the last evaluation, (n,)."""
    residual: Array
    """Task error, (5, n)."""
    J: Array
    """Jacobian with the springs held, (5, 5, n)."""
    load_J: Array
    """Learned part of the Jacobian that the load causes, (5, 5, n)."""

    def error(self) -> Array:
        """Return the larger of task error and change of strain, (n,)."""
        worst: Array = np.maximum(np.max(np.abs(self.residual), axis=0), self.strain_change)
        return worst


@dataclass(frozen=True, slots=True, eq=False)
class _Newton:
    """Newton iteration towards targets (3, n)."""

    arm: Arm
    tool: str
    p: Array
    a: Array
    gravity_R_m_s2: Array

    def begin(self, output_rad: Array, where: NDArray[np.intp]) -> _Iterate:
        """Evaluate the starts with the springs under load."""
        strain = evaluate_pose(self.arm, self.tool, output_rad, None, self.gravity_R_m_s2).strain
        return self._evaluate(where, output_rad, strain, np.zeros((5, 5, where.size)))

    def take_step(self, current: _Iterate, step: Array) -> _Iterate:
        """Take a step and update the learned part of the Jacobian (Broyden)."""
        new = self._evaluate(current.where, current.output_rad + step, current.strain, current.load_J)
        expected = np.einsum("ij...,j...->i...", 0.5 * (current.J + new.J) + current.load_J, step)
        mismatch = (new.residual - current.residual - expected) / np.maximum(
            (step * step).sum(axis=0), 1e-300
        )
        return replace(new, load_J=current.load_J + mismatch[:, None] * step[None])

    def _evaluate(self, where: NDArray[np.intp], output_rad: Array, strain: Array, load_J: Array) -> _Iterate:
        """Evaluate task and Jacobian at these angles."""
        evaluation = evaluate_pose(self.arm, self.tool, output_rad, strain, self.gravity_R_m_s2)
        for _ in range(PASSES - 1 if self.gravity_R_m_s2.any() else 0):
            evaluation = evaluate_pose(
                self.arm, self.tool, output_rad, evaluation.strain, self.gravity_R_m_s2
            )
        p, a = self.p.take(where, axis=-1), self.a.take(where, axis=-1)
        return _Iterate(
            where,
            output_rad,
            evaluation.strain,
            evaluation.torque_Nm,
            evaluation.strain_change,
            task_error(evaluation.X_RT, p, a),
            task_jacobian(evaluation.frames, evaluation.X_RT, a),
            load_J,
        )


def _column(v: Array, batch: tuple[int, ...]) -> Array:
    """Append trailing axes to a vector (3,) or (3, ...) until it has those of the batch."""
    return v.reshape(*v.shape, *(1,) * (len(batch) + 1 - v.ndim))


def damped_inverse(J: Array) -> Array:
    """Invert matrices by damped least squares, so that a singular matrix gives a finite step, (m, m, ...).

    The normal matrix is positive definite, so Gauss-Jordan elimination needs no pivoting.
    """
    inverse: Array = np.einsum("ki...,kj...->ij...", J, J)
    for k in range(len(J)):
        inverse[k, k] += DAMPING
    for k in range(len(J)):
        pivot = 1.0 / inverse[k, k]
        row, column = inverse[k] * pivot, inverse[:, k].copy()
        inverse -= column[:, None] * row
        inverse[k], inverse[:, k], inverse[k, k] = row, -column * pivot, pivot
    product: Array = np.einsum("ik...,jk...->ij...", inverse, J)
    return product


def damped_solution(J: Array, residual: Array) -> Array:
    """Solve linear least squares with damping, (k, n), so that a singular matrix gives a finite solution."""
    normal = np.einsum("ki...,kj...->...ij", J, J) + DAMPING * np.eye(J.shape[1])
    solution: Array = np.linalg.solve(normal, np.einsum("ki...,k...->...i", J, residual)[..., None])
    return solution[..., 0].T


DEFLECTED_TOLERANCE: Final = 2e-8
"""Tolerance of a root of the deflected arm: position [m], axis [rad] and change of strain."""
RIGID_TOLERANCE: Final = 2e-10
"""Tolerance of a root of the rigid arm, same units."""
CLEAR_OF_FOLD: Final = 0.3
"""Fold distance below which the tolerance falls with its square.

There the joint angles change by more than the tool does.
"""
MAX_ITERATIONS: Final = 20
LIMIT_MARGIN_RAD: Final = 0.03
"""Excess over the limits up to which a root is followed after the first iteration."""
NEAR_FOLD: Final = 0.2
"""The same excess for a root this close to a fold [m, sine]: one iteration is less accurate."""


@dataclass(frozen=True, slots=True, eq=False)
class FixedPointRoots:
    """Roots of the real arm, with the targets (n,) on the last axis."""

    output_rad: Array
    """Output angles, (5, n)."""
    torque_Nm: Array
    """Torque of the load on each output, (5, n)."""
    error: Array
    """Larger of position error [m] and axis error [rad], (n,); infinite if not selected."""
    followed: Flags
    """True if the iteration went on after its first step, (n,)."""
    converged: Flags
    """True if the error is within the tolerance, (n,)."""


def begin_fixed_point(
    arm: Arm,
    tool: str,
    p: Array,
    a: Array,
    gravity_R_m_s2: Array,
    start_rad: Array,
    fold_distance: Array,
    selected: Flags,
) -> "FixedPointSearch | FixedPointRoots":
    """Begin the search of the roots of the real arm on the branches of the orthogonal arm's roots.

    If no root is selected there is nothing to search.

    Args:
        start_rad: Output angles of the orthogonal arm's roots, shape (5, n).
        fold_distance: Distance of these roots from the nearest fold, in m or as a unitless sine, shape (n,).
    """
    n = selected.size
    largest = DEFLECTED_TOLERANCE if gravity_R_m_s2.any() else RIGID_TOLERANCE
    tolerance = largest * np.minimum(fold_distance / CLEAR_OF_FOLD, 1.0) ** 2
    roots = FixedPointRoots(
        start_rad.copy(), np.zeros_like(start_rad), np.full(n, np.inf), selected.copy(), np.zeros(n, bool)
    )
    where = np.flatnonzero(selected)
    if not where.size:
        return roots
    return FixedPointSearch(arm, tool, p, a, gravity_R_m_s2, tolerance, roots, where, None, 0)


@dataclass(frozen=True, slots=True, eq=False)
class FixedPointSearch:
    """Fixed-point iteration under way, with the targets (n,) on the last axis."""

    arm: Arm
    tool: str
    p: Array
    a: Array
    gravity_R_m_s2: Array
    tolerance: Array
    """Error at which a root has converged, (n,)."""
    roots: FixedPointRoots
    """What was found so far, for all targets."""
    where: NDArray[np.intp]
    """Indices (k,) of the targets whose roots have not converged."""
    strain: Array | None
    """Spring displacements of these, (6, 6, k); None before the first iteration."""
    iterations: int
    """Iterations that were done."""

    def advance(self) -> "FixedPointSearch | FixedPointRoots":
        """Do one iteration of each root that has not converged."""
        where = self.where
        q, p, a = (v.take(where, axis=-1) for v in (self.roots.output_rad, self.p, self.a))
        evaluation = evaluate_pose(self.arm, self.tool, q, self.strain, self.gravity_R_m_s2)
        X_RT = evaluation.X_RT
        miss = np.concatenate([X_RT.p - p, X_RT.R[:, 0] - a])
        error = np.maximum(np.max(np.abs(miss), axis=0), evaluation.strain_change)
        roots = FixedPointRoots(*(values.copy() for values in record_arrays(self.roots)))
        roots.torque_Nm[:, where], roots.error[where] = evaluation.torque_Nm, error
        active = error >= self.tolerance[where]
        roots.converged[where] = error < self.tolerance[where]
        if not active.any():
            return roots
        if self.iterations == 0:
            virtual_p, virtual_a = p - miss[:3], a - miss[3:]
            s = self.arm.orthogonal[self.tool]
            q, _ = closed_form_branch(s, virtual_p, virtual_a / norm(virtual_a), q)
        else:
            q = q - damped_solution(approach_jacobian(evaluation.frames, X_RT), miss)
        roots.output_rad[:, where[active]] = q[:, active]
        if self.iterations == 0:
            follow = _may_enter_limits(self.arm, self.tool, q[:, active])
            roots.followed[where[active]] = follow
            active[active] = follow
        if not active.any() or self.iterations + 1 == MAX_ITERATIONS:
            return roots
        strain = evaluation.strain.compress(active, axis=-1)
        return replace(self, roots=roots, where=where[active], strain=strain, iterations=self.iterations + 1)


def _may_enter_limits(arm: Arm, tool: str, q: Array) -> Flags:
    """Find the roots (5, k) that may be inside the limits, judged after one iteration."""
    fold_distance = np.abs(fold_distances(arm.orthogonal[tool], q)).min(axis=0)
    margin = np.where(fold_distance < NEAR_FOLD, NEAR_FOLD, LIMIT_MARGIN_RAD)
    may: Flags = limit_excess(arm, wrap_into_limits(arm, q)).max(axis=0) < margin
    return may


ELBOW_BIT: Final = 2
"""Bit of the elbow in the index of a branch."""
BEND: Final = 0.15
"""Sine below which an elbow is nearly straight, and least bend at the start [rad]."""
MOST_MISSING_M: Final = 0.03
"""Distance beyond the reach of the orthogonal arm within which the real arm may reach a target.

The largest was 0.014 m, over 640,000 targets of twenty calibrated arms without gravity, on Mars and Earth.
"""


def find_straight(roots: Roots) -> Flags:
    """Find the roots (8, n) of the orthogonal arm with a nearly straight elbow, in reach or nearly so."""
    straight: Flags = (roots.from_fold[1] < BEND) & (roots.missing_m < MOST_MISSING_M)
    return straight


def begin_straight(
    arm: Arm, tool: str, p: Array, a: Array, gravity_R_m_s2: Array, straight: Flags
) -> NewtonSearch | NewtonRoots:
    """Begin the search of the real arm's roots near roots of the orthogonal arm with a nearly straight elbow.

    Args:
        straight: Boolean flags of the roots of the orthogonal arm, shape (8, n).

    Returns:
        The search of the roots in the order of the flags that are true, batch (k,).
    """
    _, target = np.nonzero(straight)
    start = _bent_starts(arm, tool, p, a, straight)
    return begin_newton(arm, tool, p[:, target], a[:, target], gravity_R_m_s2, start)


def keep_on_side(arm: Arm, tool: str, p: Array, a: Array, straight: Flags, found: NewtonRoots) -> NewtonRoots:
    """Keep of what `begin_straight` found the roots on the same side of the folds of shoulder and wrist."""
    start = _bent_starts(arm, tool, p, a, straight)
    before, after = (branch_index(fold_distances(arm.orthogonal[tool], q)) for q in (start, found.output_rad))
    return replace(found, converged=found.converged & ((before ^ after) & ~ELBOW_BIT == 0))


def _bent_starts(arm: Arm, tool: str, p: Array, a: Array, straight: Flags) -> Array:
    """Compute starts (5, k) with a bent elbow, from the convex side of the fold."""
    slot, target = np.nonzero(straight)
    some, own = np.unique(target, return_inverse=True)
    starts: Array = closed_form(arm, tool, p[:, some], a[:, some], BEND).output_rad[:, slot, own]
    return starts
