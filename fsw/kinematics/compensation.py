"""Inverse kinematics of the arm as it hangs: angles such that the deflected tool meets its target."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import Frames, forward, joint_jacobian, tool_pose
from fsw.kinematics.statics import load, rest
from fsw.kinematics.transforms import Array, Pose, compose, cross, dot, rotate

TASK_TOLERANCE = 1e-10
STEPS_PER_ROUND = 8
MAX_ROUNDS = 6
PROGRESS = 0.5
"""A round must bring the error down to this share of what it was, or the target is given up."""
DAMPING = 1e-12
BLOCK = 400
"""Targets at a time: their arrays stay in the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class Compensated:
    """Joint angles that put the deflected tool on its target, batch axes trailing."""

    output_rad: Array
    """(5, ...), at the output."""
    torque_Nm: Array
    """(5, ...), of gravity on each output at this pose: what winds the gear up."""
    error: Array
    """(...), what is left: the largest of position error [m] and axis error [rad]."""
    converged: NDArray[np.bool_]


def refine(
    arm: Arm,
    tool: int,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array,
    start_rad: Array,
    tolerance: float = TASK_TOLERANCE,
    steps_per_jacobian: int = STEPS_PER_ROUND,
) -> Compensated:
    """Newton steps from `start_rad` (5, ...) until the tool stands at p with its x axis along the approach.

    Target (3, ...) and gravity (3,). The load is brought up to date in every step, so deflection and angles
    converge together; zero gravity gives the rigid arm. The Jacobian changes little away from double roots
    and is kept for a round of steps, after which converged and hopeless targets are left out. A start that is
    not finite, or a target out of reach, does not converge.
    """
    batch = start_rad.shape[1:]
    p, a = (np.broadcast_to(_column(v, batch), (3, *batch)).reshape(3, -1) for v in (p_RoTo_R_m, approach_R))
    task = _Task(arm, tool, p, a, gravity_R_m_s2, tolerance, steps_per_jacobian)
    q = np.array(start_rad, dtype=float).reshape(5, -1)
    strain = np.zeros((6, 6, q.shape[1]))
    torque, error = np.zeros_like(q), np.full(q.shape[1], np.inf)
    active = np.flatnonzero(np.isfinite(q).all(axis=0))
    for _ in range(MAX_ROUNDS):
        if not active.size:
            break
        before = error[active]
        for block in np.split(active, range(BLOCK, active.size, BLOCK)):
            q[:, block], strain[:, :, block], torque[:, block], error[block] = task.round(
                q[:, block], strain[:, :, block], block
            )
        going = (error[active] >= tolerance) & (error[active] < PROGRESS * before)
        active = active[going]
    converged = error < tolerance
    flat = (q, torque, error, converged)
    return Compensated(*(v.reshape((*v.shape[:-1], *batch)) for v in flat))


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """What a round of Newton steps needs, for targets (3, n)."""

    arm: Arm
    tool: int
    p: Array
    a: Array
    gravity_R_m_s2: Array
    tolerance: float
    steps_per_jacobian: int

    def round(self, q: Array, strain: Array, where: NDArray[np.intp]) -> tuple[Array, Array, Array, Array]:
        """Angles, strains, torques and errors of the targets `where` after some steps.

        The error is the larger of what is missing at the tool and what the strains still change.
        """
        p, a = self.p[:, where], self.a[:, where]
        for count in range(STEPS_PER_ROUND + 1):
            frames = forward(self.arm, q, strain)
            X_RT = tool_pose(self.arm, frames, self.tool)
            error = task_error(X_RT, p, a)
            new_strain, torque = load(self.arm, frames, strain, self.gravity_R_m_s2)
            worst = np.maximum(
                np.max(np.abs(error), axis=0), np.max(np.abs(new_strain - strain), axis=(0, 1))
            )
            if count == STEPS_PER_ROUND or np.all(worst < self.tolerance):
                break
            if count % self.steps_per_jacobian == 0:
                J_inv = _damped_inverse(task_jacobian(frames, X_RT, a))
            ahead = task_error(_sagged(frames, new_strain - strain, X_RT), p, a)
            q = q - np.einsum("ij...,j...->i...", J_inv, ahead)
            strain = new_strain
        return q, strain, torque, worst


def _sagged(frames: Frames, change: Array, X_RT: Pose) -> Pose:
    """Where the tool will be when the springs have taken a small change of strain (6, 6, n), to first order.

    So that a step of the joints already answers the load that was found at its start.
    """
    turns = rotate(frames.X_RL.R, change[:3])
    shifts = rotate(frames.X_RL.R, change[3:])
    spring = rotate(frames.X_RL.R, frames.X_LD.p) + frames.X_RL.p
    turn = turns.sum(axis=1)
    p_m = X_RT.p + (cross(turns, X_RT.p[:, None] - spring) + shifts).sum(axis=1)
    return Pose(X_RT.R + np.stack([cross(turn, X_RT.R[:, k]) for k in range(3)], axis=1), p_m)


def _column(v: Array, batch: tuple[int, ...]) -> Array:
    """A vector (3,) or (3, ...) with as many trailing axes as the batch has."""
    return v.reshape(*v.shape, *(1,) * (len(batch) + 1 - v.ndim))


def relative_target(
    arm: Arm,
    reference_tool: int,
    reference_rad: Array,
    gravity_R_m_s2: Array,
    p_RoTo_R_m: Array,
    approach_R: Array,
) -> tuple[Array, Array]:
    """The target for `refine` when only the difference of deflection to a reference pose is to count.

    At the reference pose (outputs, 5) the reference tool is known to be in place, whatever the deflection
    there. So that deflection, the displacement of the tool from rigid to deflected, is counted to the world:
    the target (3, ...) moves along with it.
    """
    rigid = tool_pose(arm, forward(arm, reference_rad), reference_tool)
    deflected = tool_pose(arm, rest(arm, reference_rad, gravity_R_m_s2).frames, reference_tool)
    turn = compose(deflected.R, np.swapaxes(rigid.R, 0, 1))
    ones = (1,) * (p_RoTo_R_m.ndim - 1)
    pivot, shifted = rigid.p.reshape(3, *ones), deflected.p.reshape(3, *ones)
    turn = turn.reshape(3, 3, *ones)
    return rotate(turn, p_RoTo_R_m - pivot) + shifted, rotate(turn, approach_R)


def task_error(X_RT: Pose, p_RoTo_R_m: Array, approach_R: Array) -> Array:
    """Position error and the approach's components along the tool's y and z axes, (5, ...)."""
    miss = X_RT.p - p_RoTo_R_m
    along = np.einsum("ij...,i...->j...", X_RT.R, np.broadcast_to(approach_R, miss.shape))
    # pointing the other way has the same zero components: make it large, so that it is never an answer
    away = np.copysign(along[:1] < 0, along[1:2])
    return np.concatenate([miss, along[1:2] + away, along[2:]])


def task_jacobian(frames: Frames, X_RT: Pose, approach_R: Array) -> Array:
    """Derivative of task_error by the joint angles, springs held, (5, 5, ...)."""
    J = joint_jacobian(frames, X_RT.p)
    a = np.broadcast_to(approach_R, X_RT.p.shape)
    # (w x y) . a = w . (y x a)
    turning = [dot(cross(X_RT.R[:, k], a)[:, None], J[:3]) for k in (1, 2)]
    return np.concatenate([J[3:], np.stack(turning)])


def _damped_inverse(J: Array) -> Array:
    """Least squares with a trace of damping, so that a singular pose gives a step and not an exception."""
    A = np.moveaxis(J, (0, 1), (-2, -1))
    A_T = np.swapaxes(A, -1, -2)
    normal: Array = A_T @ A + DAMPING * np.eye(5)
    inverses: Array = np.asarray(np.linalg.solve(normal, A_T), np.float64)
    return np.moveaxis(inverses, (-2, -1), (0, 1))
