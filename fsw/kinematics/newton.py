"""Newton iteration to roots of the deflected arm; it converges at double roots as well."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm
from fsw.kinematics.batch import select_targets
from fsw.kinematics.task import ROOT_TOLERANCE, evaluate_pose, task_error, task_jacobian
from fsw.kinematics.transforms import Array, Flags

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
BLOCK: Final = 8000
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
    arm: Arm,
    tool: str,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array,
    start_rad: Array,
) -> NewtonRoots:
    """Refine starts by Newton steps until the tool meets its target.

    Every step updates the load, so deflection and angles converge together. A secant correction (Broyden)
    learns the part of the Jacobian that the load causes. Without it, double roots do not converge.

    Args:
        arm: Arm.
        tool: Name of the tool.
        p_RoTo_R_m: Target positions in the rover frame, shape (3, ...).
        approach_R: Approach directions, unit vectors in the rover frame, shape (3, ...).
        gravity_R_m_s2: Gravity in the rover frame, shape (3,); zero for the rigid arm.
        start_rad: Output angles to start from, shape (5, ...); starts that are not finite do not converge.

    Returns:
        The roots, batch (...).
    """
    batch = start_rad.shape[1:]
    p, a = (np.broadcast_to(_column(v, batch), (3, *batch)).reshape(3, -1) for v in (p_RoTo_R_m, approach_R))
    start = start_rad.reshape(5, -1)
    n = start.shape[1]
    done = NewtonRoots(start.astype(float), np.zeros_like(start), np.full(n, np.inf), np.zeros(n, bool))
    finite = np.flatnonzero(np.isfinite(start).all(axis=0))
    for block in np.split(finite, range(BLOCK, finite.size, BLOCK)):
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
    """Invert matrices by damped least squares, so that a singular matrix gives a finite step.

    The normal matrix is positive definite, so Gauss-Jordan elimination needs no pivoting.

    Args:
        J: Matrices of any unit, shape (m, m, ...).

    Returns:
        The inverses, shape (m, m, ...).
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
    """Solve linear least squares with damping, so that a singular matrix gives a finite solution.

    Args:
        J: Matrices of any unit, shape (m, k, n).
        residual: Right sides of any unit, shape (m, n).

    Returns:
        The solutions, shape (k, n).
    """
    normal = np.einsum("ki...,kj...->...ij", J, J) + DAMPING * np.eye(J.shape[1])
    solution: Array = np.linalg.solve(normal, np.einsum("ki...,k...->...i", J, residual)[..., None])
    return solution[..., 0].T
