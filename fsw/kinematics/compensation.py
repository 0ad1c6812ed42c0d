"""Inverse kinematics of the arm as it hangs: angles such that the deflected tool meets its target."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import Frames, forward, joint_jacobian, tool_pose
from fsw.kinematics.statics import load
from fsw.kinematics.transforms import Array

TASK_TOLERANCE = 1e-10
MAX_STEPS = 25
DAMPING = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Compensated:
    """Joint angles that put the deflected tool on its target, leading axes as given."""

    output_rad: Array
    """(..., 5), at the output."""
    torque_Nm: Array
    """(..., 5), of gravity on each output at this pose: what winds the gear up."""
    error: Array
    """(...), what is left: the largest of position error [m] and axis error [rad]."""
    converged: NDArray[np.bool_]


def refine(
    arm: Arm, tool: int, p_RoTo_R_m: Array, approach_R: Array, gravity_R_m_s2: Array, start_rad: Array
) -> Compensated:
    """Newton steps from `start_rad` (..., 5) until the tool stands at p with its x axis along the approach.

    The load is brought up to date in every step, so deflection and angles converge together; zero gravity
    gives the rigid arm. A start that is not finite, or a target out of reach, does not converge.
    """
    q = np.asarray(start_rad, float)
    strain = np.zeros((*q.shape[:-1], 6, 6))
    for _ in range(MAX_STEPS):
        frames = forward(arm, q, strain)
        X_RT = tool_pose(arm, frames, tool)
        error = task_error(X_RT, p_RoTo_R_m, approach_R)
        new_strain, torque = load(arm, frames, strain, gravity_R_m_s2)
        change = np.max(np.abs(new_strain - strain), axis=(-2, -1))
        worst = np.max(np.abs(error), axis=-1)
        done = (worst < TASK_TOLERANCE) & (change < TASK_TOLERANCE)
        if np.all(done | ~np.isfinite(worst)):
            break
        q = q - _newton_step(task_jacobian(frames, X_RT, approach_R), error)
        strain = new_strain
    return Compensated(q, torque, worst, done)


def task_error(X_RT: Array, p_RoTo_R_m: Array, approach_R: Array) -> Array:
    """Position error and the approach's components along the tool's y and z axes, (..., 5)."""
    error = np.empty((*X_RT.shape[:-2], 5))
    error[..., :3] = X_RT[..., :3, 3] - p_RoTo_R_m
    error[..., 3:] = (approach_R[..., None, :] @ X_RT[..., :3, 1:3])[..., 0, :]
    # pointing the other way has the same zero error: make it large, so that it is never an answer
    backward = np.sum(approach_R * X_RT[..., :3, 0], axis=-1) < 0
    error[..., 3] += np.where(backward, np.copysign(1.0, error[..., 3]), 0.0)
    return error


def task_jacobian(frames: Frames, X_RT: Array, approach_R: Array) -> Array:
    """Derivative of task_error by the joint angles, springs held, (..., 5, 5)."""
    J = joint_jacobian(frames, X_RT[..., :3, 3])
    task = np.empty((*J.shape[:-2], 5, 5))
    task[..., :3, :] = J[..., 3:, :]
    axes = np.swapaxes(X_RT[..., :3, 1:3], -1, -2)
    # (w x y) . a = w . (y x a)
    task[..., 3:, :] = np.cross(axes, approach_R[..., None, :]) @ J[..., :3, :]
    return task


def _newton_step(J: Array, error: Array) -> Array:
    """Least squares with a trace of damping, so that a singular pose gives a step and not an exception."""
    J_T = np.swapaxes(J, -1, -2)
    normal: Array = J_T @ J + DAMPING * np.eye(5)
    return np.asarray(np.linalg.solve(normal, J_T @ error[..., None])[..., 0], np.float64)
