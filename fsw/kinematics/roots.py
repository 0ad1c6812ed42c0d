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
from fsw.kinematics.transforms import Array, Flags, norm, select_targets

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
"""Starts per block, to bound the memory; late steps of few starts have a fixed cost per block."""


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

    Every step updates the load, so deflection and angles converge together. A secant correction (Broyden)
    learns the part of the Jacobian that the load causes. Without it, double roots do not converge.

    Args:
        start_rad: Output angles to start from, shape (5, ...); starts that are not finite do not converge.
    """
    batch = start_rad.shape[1:]
    p, a = (np.broadcast_to(_column(v, batch), (3, *batch)).reshape(3, -1) for v in (p_RoTo_R_m, approach_R))
    start = start_rad.reshape(5, -1)
    n = start.shape[1]
    done = NewtonRoots(start.astype(float), np.zeros_like(start), np.full(n, np.inf), np.zeros(n, bool))
    finite = np.flatnonzero(np.isfinite(start).all(axis=0))
    for block in np.split(finite, range(NEWTON_BLOCK, finite.size, NEWTON_BLOCK)):
        _refine_block(_Newton(arm, tool, p, a, gravity_R_m_s2), block, done)
    values = (done.output_rad, done.torque_Nm, done.error, done.error < ROOT_TOLERANCE)
    return NewtonRoots(*(v.reshape((*v.shape[:-1], *batch)) for v in values))


def _refine_block(newton: "_Newton", where: NDArray[np.intp], done: NewtonRoots) -> None:
    """Iterate the starts `where` and write the results into `done`."""
    if not where.size:
        return
    current = newton.begin(done.output_rad.take(where, axis=-1), where)
    for count in range(2 * PATIENCE):
        J_inv = damped_inverse(current.J + current.load_J)
        step = -np.einsum("ij...,j...->i...", J_inv, current.residual)
        step *= np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(np.max(np.abs(step), axis=0), 1e-300))
        current = newton.take_step(current, step)
        error = current.error()
        done.output_rad[:, current.where] = current.output_rad
        done.torque_Nm[:, current.where], done.error[current.where] = current.torque_Nm, error
        active = (error >= TASK_TOLERANCE) | (np.max(np.abs(step), axis=0) >= STEP_TOLERANCE_RAD)
        active &= np.isfinite(error) & ((count < PATIENCE) | (error < HOPELESS_ERROR))
        if not active.any():
            return
        if not active.all():
            current = select_targets(current, active)


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
FIXED_POINT_BLOCK: Final = 6000
"""Roots per block, to bound the memory."""


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


def solve_fixed_point(
    arm: Arm,
    tool: str,
    p: Array,
    a: Array,
    gravity_R_m_s2: Array,
    start_rad: Array,
    fold_distance: Array,
    selected: Flags,
) -> FixedPointRoots:
    """Find the roots of the real arm on the branches of the orthogonal arm's roots.

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
    indices = np.flatnonzero(selected)
    for block in np.split(indices, range(FIXED_POINT_BLOCK, indices.size, FIXED_POINT_BLOCK)):
        targets = p.take(block, axis=-1), a.take(block, axis=-1)
        _solve_block(arm, tool, *targets, gravity_R_m_s2, tolerance[block], block, roots)
    return replace(roots, converged=roots.error < tolerance)


def _solve_block(
    arm: Arm,
    tool: str,
    p: Array,
    a: Array,
    gravity: Array,
    tolerance: Array,
    where: NDArray[np.intp],
    roots: FixedPointRoots,
) -> None:
    """Iterate the targets `where` until their error is below tolerance; write into `roots`.

    `take` and `compress` leave the roots next to each other in memory, which an index does not.
    """
    q, strain = roots.output_rad.take(where, axis=-1), None
    for iteration in range(MAX_ITERATIONS):
        evaluation = evaluate_pose(arm, tool, q, strain, gravity)
        X_RT, strain = evaluation.X_RT, evaluation.strain
        miss = np.concatenate([X_RT.p - p, X_RT.R[:, 0] - a])
        error = np.maximum(np.max(np.abs(miss), axis=0), evaluation.strain_change)
        roots.torque_Nm[:, where], roots.error[where] = evaluation.torque_Nm, error
        active = error >= tolerance
        if not active.any():
            return
        if iteration == 0:
            virtual_p, virtual_a = p - miss[:3], a - miss[3:]
            q, _ = closed_form_branch(arm.orthogonal[tool], virtual_p, virtual_a / norm(virtual_a), q)
        else:
            q = q - damped_solution(approach_jacobian(evaluation.frames, X_RT), miss)
        if not active.all():
            where, tolerance = where[active], tolerance[active]
            p, a, q, strain = (v.compress(active, axis=-1) for v in (p, a, q, strain))
        roots.output_rad[:, where] = q
        if iteration == 0:
            follow = _may_enter_limits(arm, tool, q)
            roots.followed[where] = follow
            if not follow.any():
                return
            where, tolerance = where[follow], tolerance[follow]
            p, a, q, strain = (v.compress(follow, axis=-1) for v in (p, a, q, strain))


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


def solve_straight(
    arm: Arm, tool: str, p: Array, a: Array, gravity_R_m_s2: Array, straight: Flags
) -> NewtonRoots:
    """Find the roots of the real arm near roots of the orthogonal arm with a nearly straight elbow.

    Args:
        straight: Boolean flags of the roots of the orthogonal arm, shape (8, n).

    Returns:
        The roots in the order of the flags that are true, batch (k,). Only a root on the same side of the
        folds of shoulder and wrist as its start is one.
    """
    slot, target = np.nonzero(straight)
    some, own = np.unique(target, return_inverse=True)
    start = closed_form(arm, tool, p[:, some], a[:, some], BEND).output_rad[:, slot, own]
    found = refine_roots(arm, tool, p[:, target], a[:, target], gravity_R_m_s2, start)
    before, after = (branch_index(fold_distances(arm.orthogonal[tool], q)) for q in (start, found.output_rad))
    return replace(found, converged=found.converged & ((before ^ after) & ~ELBOW_BIT == 0))
