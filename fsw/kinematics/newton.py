"""Newton steps from near a root to the root, of the arm as it hangs, close to double roots as well."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm
from fsw.kinematics.batch import select_targets
from fsw.kinematics.task import ROOT_TOLERANCE, evaluate_pose, task_error, task_jacobian
from fsw.kinematics.transforms import Array, Flags, norm, wrap_angle

TASK_TOLERANCE: Final = 1e-11
"""Of a root: position [m], axis [rad] and what the strains still change."""
STEP_TOLERANCE_RAD: Final = 1e-7
LONGEST_STEP_RAD: Final = 0.4
PASSES: Final = 2
"""Of load and deflection at every look; with one, the strain lags by more than a double root's slope."""
PATIENCE: Final = 15
"""A start that is not close to a root after so many steps is given up, and any after as many more."""
HOPELESS_ERROR: Final = 1e-3
DAMPING: Final = 1e-12
CURVATURE: Final = 8.0
"""Of the task, along steps of length one [m, rad]: its largest second derivative is 3.5 for these links.
The rest allows for the load's part of the Jacobian, which is learned."""
CERTAIN: Final = 0.25
"""Of CURVATURE, inverse Jacobian and step; below 1/2 a root exists and is the only one (Kantorovich). The
radii in _first_of_each follow from it."""
BLOCK: Final = 8000
"""Starts at a time, to bound the memory: late steps, of the few that are left, cost as much a block."""


@dataclass(frozen=True, slots=True, eq=False)
class NewtonRoots:
    """Joint angles that put the tool on its target, batch axes trailing."""

    output_rad: Array
    """(5, ...), at the output."""
    torque_Nm: Array
    """(5, ...), of gravity on each output at this pose: what winds the gear up."""
    error: Array
    """(...), what is left: the largest of position error [m] and axis error [rad]."""
    converged: Flags


def refine_roots(
    arm: Arm,
    tool: int,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array,
    start_rad: Array,
    patience: int = PATIENCE,
    target: NDArray[np.intp] | None = None,
) -> NewtonRoots:
    """Newton steps from `start_rad` (5, ...) until the tool stands at p with its x axis along the approach.

    Target (3, ...) and gravity (3,); zero gravity gives the rigid arm. The load is brought up to date in
    every step, so deflection and angles converge together. How the load answers the steps is learned on the
    way (a secant correction to the Jacobian of the springs held), which near double roots is what makes
    them converge. A start that is not finite, or a target out of reach, does not converge.

    With `target` (n,), in order, of starts that certainly lead to the same root of a target one is followed,
    and the others stay where they are.
    """
    batch = start_rad.shape[1:]
    p, a = (np.broadcast_to(_column(v, batch), (3, *batch)).reshape(3, -1) for v in (p_RoTo_R_m, approach_R))
    start = start_rad.reshape(5, -1)
    n = start.shape[1]
    done = NewtonRoots(start.astype(float), np.zeros_like(start), np.full(n, np.inf), np.zeros(n, bool))
    finite = np.flatnonzero(np.isfinite(start).all(axis=0))
    for block in np.split(finite, range(BLOCK, finite.size, BLOCK)):
        _refine_block(_Newton(arm, tool, p, a, gravity_R_m_s2), block, done, patience, target)
    values = (done.output_rad, done.torque_Nm, done.error, done.error < ROOT_TOLERANCE)
    return NewtonRoots(*(v.reshape((*v.shape[:-1], *batch)) for v in values))


def _refine_block(
    newton: "_Newton",
    where: NDArray[np.intp],
    done: NewtonRoots,
    patience: int,
    target: NDArray[np.intp] | None,
) -> None:
    """Steps for the starts `where`, written into `done`."""
    if not where.size:
        return
    at = newton.begin(done.output_rad[:, where], where)
    for count in range(2 * patience):
        J_inv = damped_inverse(at.J + at.load_J)
        step = -np.einsum("ij...,j...->i...", J_inv, at.residual)
        if target is not None:
            first = _first_of_each_root(at, J_inv, step, target[at.where])
            if not first.all():
                at, step = select_targets(at, first), step[:, first]
        step *= np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(np.max(np.abs(step), axis=0), 1e-300))
        at = newton.take_step(at, step)
        error = at.error()
        done.output_rad[:, at.where] = at.output_rad
        done.torque_Nm[:, at.where], done.error[at.where] = at.torque_Nm, error
        going = (error >= TASK_TOLERANCE) | (np.max(np.abs(step), axis=0) >= STEP_TOLERANCE_RAD)
        going &= np.isfinite(error) & ((count < patience) | (error < HOPELESS_ERROR))
        if not going.any():
            return
        if not going.all():
            at = select_targets(at, going)


def _first_of_each_root(at: "_Iterate", J_inv: Array, step: Array, target: NDArray[np.intp]) -> Flags:
    """Which iterates are the first, of those of a target, that certainly lead to their root.

    Kantorovich: with CERTAIN a root is within 6/5 of the step of an iterate, and no other is within
    1.7 / (CURVATURE times the inverse Jacobian).
    """
    bound = CURVATURE * np.sqrt(np.einsum("ij...,ij...->...", J_inv, J_inv))
    length = norm(step)
    certain = np.flatnonzero((bound * length < CERTAIN) & (at.strain_change < length))
    end = wrap_angle(at.output_rad + step)[:, certain]
    order = np.lexsort((end[0] + end[1] + end[2], target[certain]))
    certain, end = certain[order], end[:, order]
    apart = norm(wrap_angle(np.diff(end))) + length[certain[:-1]] + length[certain[1:]] / 5
    same = (np.diff(target[certain]) == 0) & (apart < 1.7 / bound[certain[:-1]])
    first = np.ones(target.size, bool)
    first[certain[1:][same]] = False
    return first


@dataclass(frozen=True, slots=True, eq=False)
class _Iterate:
    """Where the steps have come to; every field has the starts, (n,), as its last axis."""

    where: NDArray[np.intp]
    """Which starts these are."""
    output_rad: Array
    strain: Array
    torque_Nm: Array
    strain_change: Array
    residual: Array
    """(5, n), of the task."""
    J: Array
    """(5, 5, n), springs held."""
    load_J: Array
    """(5, 5, n), what the load's answer adds, as learned so far."""

    def error(self) -> Array:
        """The larger of what is missing at the tool and what the strains still change."""
        worst: Array = np.maximum(np.max(np.abs(self.residual), axis=0), self.strain_change)
        return worst


@dataclass(frozen=True, slots=True, eq=False)
class _Newton:
    """Steps towards targets (3, n)."""

    arm: Arm
    tool: int
    p: Array
    a: Array
    gravity_R_m_s2: Array

    def begin(self, output_rad: Array, where: NDArray[np.intp]) -> _Iterate:
        """The starts, their springs under load."""
        strain = evaluate_pose(self.arm, self.tool, output_rad, None, self.gravity_R_m_s2).strain
        return self._at(where, output_rad, strain, np.zeros((5, 5, where.size)))

    def take_step(self, at: _Iterate, step: Array) -> _Iterate:
        """The state after a step, with what it taught about the load (Broyden's update)."""
        new = self._at(at.where, at.output_rad + step, at.strain, at.load_J)
        expected = np.einsum("ij...,j...->i...", 0.5 * (at.J + new.J) + at.load_J, step)
        surprise = (new.residual - at.residual - expected) / np.maximum((step * step).sum(axis=0), 1e-300)
        return replace(new, load_J=at.load_J + surprise[:, None] * step[None])

    def _at(self, where: NDArray[np.intp], output_rad: Array, strain: Array, load_J: Array) -> _Iterate:
        tried = evaluate_pose(self.arm, self.tool, output_rad, strain, self.gravity_R_m_s2)
        for _ in range(PASSES - 1 if self.gravity_R_m_s2.any() else 0):
            tried = evaluate_pose(self.arm, self.tool, output_rad, tried.strain, self.gravity_R_m_s2)
        p, a = self.p[:, where], self.a[:, where]
        return _Iterate(
            where,
            output_rad,
            tried.strain,
            tried.torque_Nm,
            tried.strain_change,
            task_error(tried.X_RT, p, a),
            task_jacobian(tried.frames, tried.X_RT, a),
            load_J,
        )


def _column(v: Array, batch: tuple[int, ...]) -> Array:
    """A vector (3,) or (3, ...) with as many trailing axes as the batch has."""
    return v.reshape(*v.shape, *(1,) * (len(batch) + 1 - v.ndim))


def damped_inverse(J: Array) -> Array:
    """Least squares with a trace of damping, so that a singular J (m, m, ...) gives a step and no exception.

    The normal matrix is positive definite, so that Gauss and Jordan's elimination needs no pivoting.
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
