"""Newton steps from near a root to the root, of the arm as it hangs, close to double roots as well."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm
from fsw.kinematics.records import at_targets
from fsw.kinematics.task import ROOT_TOLERANCE, task_error, task_jacobian, try_pose
from fsw.kinematics.transforms import Array, Flags

TASK_TOLERANCE: Final = 1e-11
"""Of a root: position [m], axis [rad] and what the strains still change."""
STEP_TOLERANCE_RAD: Final = 1e-7
LONGEST_STEP_RAD: Final = 0.4
PASSES: Final = 2
"""Of load and deflection at every look; with one, the strain lags by more than a double root's slope."""
PATIENCE: Final = 15
"""A start that is not close to a root after so many steps is given up, and any after as many more."""
HOPELESS: Final = 1e-3
DAMPING: Final = 1e-12
BLOCK: Final = 2000
"""Starts at a time: their arrays stay in the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Joint angles that put the tool on its target, batch axes trailing."""

    output_rad: Array
    """(5, ...), at the output."""
    torque_Nm: Array
    """(5, ...), of gravity on each output at this pose: what winds the gear up."""
    error: Array
    """(...), what is left: the largest of position error [m] and axis error [rad]."""
    converged: Flags


def refine(
    arm: Arm,
    tool: int,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array,
    start_rad: Array,
    patience: int = PATIENCE,
) -> Refined:
    """Newton steps from `start_rad` (5, ...) until the tool stands at p with its x axis along the approach.

    Target (3, ...) and gravity (3,); zero gravity gives the rigid arm. The load is brought up to date in
    every step, so deflection and angles converge together. How the load answers the steps is learned on the
    way (a secant correction to the Jacobian of the springs held), which near double roots is what makes
    them converge. A start that is not finite, or a target out of reach, does not converge.
    """
    batch = start_rad.shape[1:]
    p, a = (np.broadcast_to(_column(v, batch), (3, *batch)).reshape(3, -1) for v in (p_RoTo_R_m, approach_R))
    start = start_rad.reshape(5, -1)
    n = start.shape[1]
    done = Refined(start.astype(float), np.zeros_like(start), np.full(n, np.inf), np.zeros(n, bool))
    finite = np.flatnonzero(np.isfinite(start).all(axis=0))
    for block in np.split(finite, range(BLOCK, finite.size, BLOCK)):
        _refine_block(_Newton(arm, tool, p, a, gravity_R_m_s2), block, done, patience)
    values = (done.output_rad, done.torque_Nm, done.error, done.error < ROOT_TOLERANCE)
    return Refined(*(v.reshape((*v.shape[:-1], *batch)) for v in values))


def _refine_block(newton: "_Newton", where: NDArray[np.intp], done: Refined, patience: int) -> None:
    """Steps for the starts `where`, written into `done`."""
    if not where.size:
        return
    at = newton.begin(done.output_rad[:, where], where)
    for count in range(2 * patience):
        step = newton.step(at)
        at = newton.moved(at, step)
        error = at.error()
        done.output_rad[:, at.where] = at.output_rad
        done.torque_Nm[:, at.where], done.error[at.where] = at.torque_Nm, error
        going = (error >= TASK_TOLERANCE) | (np.max(np.abs(step), axis=0) >= STEP_TOLERANCE_RAD)
        going &= np.isfinite(error) & ((count < patience) | (error < HOPELESS))
        if not going.any():
            return
        if not going.all():
            at = at_targets(at, going)


@dataclass(frozen=True, slots=True, eq=False)
class _Iterate:
    """Where the steps have come to; every field has the starts, (n,), as its last axis."""

    where: NDArray[np.intp]
    """Which starts these are."""
    output_rad: Array
    strain: Array
    torque_Nm: Array
    unrest: Array
    residual: Array
    """(5, n), of the task."""
    J: Array
    """(5, 5, n), springs held."""
    load_J: Array
    """(5, 5, n), what the load's answer adds, as learned so far."""

    def error(self) -> Array:
        """The larger of what is missing at the tool and what the strains still change."""
        worst: Array = np.maximum(np.max(np.abs(self.residual), axis=0), self.unrest)
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
        n = where.size
        strain = try_pose(self.arm, self.tool, output_rad, None, self.gravity_R_m_s2).strain
        return self._at(where, output_rad, strain, np.zeros((5, 5, n)))

    def step(self, at: _Iterate) -> Array:
        """The Newton step, (5, n), no component longer than allowed."""
        J_inv = _damped_inverse(at.J + at.load_J)
        step = -np.einsum("ij...,j...->i...", J_inv, at.residual)
        longest = np.max(np.abs(step), axis=0)
        scaled: Array = step * np.minimum(1.0, LONGEST_STEP_RAD / np.maximum(longest, 1e-300))
        return scaled

    def moved(self, at: _Iterate, step: Array) -> _Iterate:
        """The state after a step, with what it taught about the load (Broyden's update)."""
        new = self._at(at.where, at.output_rad + step, at.strain, at.load_J)
        expected = np.einsum("ij...,j...->i...", 0.5 * (at.J + new.J) + at.load_J, step)
        surprise = (new.residual - at.residual - expected) / np.maximum((step * step).sum(axis=0), 1e-300)
        return replace(new, load_J=at.load_J + surprise[:, None] * step[None])

    def _at(self, where: NDArray[np.intp], output_rad: Array, strain: Array, load_J: Array) -> _Iterate:
        tried = try_pose(self.arm, self.tool, output_rad, strain, self.gravity_R_m_s2)
        for _ in range(PASSES - 1 if self.gravity_R_m_s2.any() else 0):
            tried = try_pose(self.arm, self.tool, output_rad, tried.strain, self.gravity_R_m_s2)
        p, a = self.p[:, where], self.a[:, where]
        return _Iterate(
            where,
            output_rad,
            tried.strain,
            tried.torque_Nm,
            tried.unrest,
            task_error(tried.X_RT, p, a),
            task_jacobian(tried.frames, tried.X_RT, a),
            load_J,
        )


def _column(v: Array, batch: tuple[int, ...]) -> Array:
    """A vector (3,) or (3, ...) with as many trailing axes as the batch has."""
    return v.reshape(*v.shape, *(1,) * (len(batch) + 1 - v.ndim))


def _damped_inverse(J: Array) -> Array:
    """Least squares with a trace of damping, so that a singular pose gives a step and not an exception."""
    A = np.moveaxis(J, (0, 1), (-2, -1))
    A_T = np.swapaxes(A, -1, -2)
    normal: Array = A_T @ A + DAMPING * np.eye(5)
    inverses: Array = np.asarray(np.linalg.solve(normal, A_T), np.float64)
    return np.moveaxis(inverses, (-2, -1), (0, 1))
